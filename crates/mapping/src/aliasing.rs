//! Which places of a map look alike.

use adjustment::parallel;
use map::contents::MapContents;
use map::{Alias, KeyframeAliases};
use protocol::KeyframeId;
use recognition::LoadedMap;
use std::collections::{BTreeMap, BTreeSet};

use super::error::BuildError;
use super::progress::{Progress, Stage};

/// Compares the keyframes of which it is not known yet with the rest of the map, and states in it which places they could be
/// taken for. A former keyframe that a new one looks like gets the new one as an alias; it is not compared again.
///
/// # Errors
/// [`BuildError`] for a map that cannot be searched, which remains as it was.
pub fn find_aliases(contents: &mut MapContents, progress: Progress<'_>) -> Result<(), BuildError> {
    let searched = contents.clone();
    find_aliases_in(searched, contents, progress)
}

/// The same for a map whose covariances between keyframes are too large to be held twice: each keyframe is compared as if its error were
/// independent of those of others.
///
/// # Errors
/// As of [`find_aliases`].
pub fn find_aliases_of_independent(
    contents: &mut MapContents,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let searched = MapContents {
        keyframes: contents.keyframes.clone(),
        landmarks: contents.landmarks.clone(),
        ..MapContents::empty(contents.info.clone())
    };
    find_aliases_in(searched, contents, progress)
}

fn find_aliases_in(
    searched: MapContents,
    contents: &mut MapContents,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let known: BTreeSet<KeyframeId> = contents.aliases.iter().map(|aliases| aliases.keyframe).collect();
    let ids = contents.keyframes.iter().map(|keyframe| keyframe.id);
    let new: Vec<KeyframeId> = ids.filter(|id| !known.contains(id)).collect();
    let map = LoadedMap::from_contents(searched)?;
    let search = |at: usize| map.keyframe_aliases(new[at]);
    let found = parallel::map(new.len(), search, |done| progress(Stage::Aliasing, done, new.len()));
    let found: Vec<KeyframeAliases> = found.into_iter().collect::<Result<_, _>>()?;
    let mut known: BTreeMap<KeyframeId, Vec<Alias>> =
        contents.aliases.drain(..).map(|aliases| (aliases.keyframe, aliases.places)).collect();
    for aliases in found {
        for place in &aliases.places {
            let seen_from = Alias { keyframe: aliases.keyframe, log_odds: place.log_odds };
            if let Some(former) = known.get_mut(&place.keyframe) {
                former.push(seen_from);
            }
        }
        contents.aliases.push(aliases);
    }
    for (keyframe, mut places) in known {
        places.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        contents.aliases.push(KeyframeAliases { keyframe, places });
    }
    contents.sort();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use testing::{Place, PlaceOptions, add_copy_beside};

    #[test]
    fn a_map_that_cannot_be_searched_keeps_its_aliases() {
        let place = Place::new(&PlaceOptions { keyframes: 4, landmarks: 200, ..PlaceOptions::default() });
        let mut map = place.map;
        let known = map.keyframes[0].id;
        map.aliases.push(KeyframeAliases { keyframe: known, places: Vec::new() });
        // A descriptor of another length.
        map.landmarks[3].observations[0].descriptor.pop();
        let before = map.clone();
        find_aliases(&mut map, &mut |_, _, _| ()).unwrap_err();
        find_aliases_of_independent(&mut map, &mut |_, _, _| ()).unwrap_err();
        assert_eq!(map, before);
    }

    #[test]
    fn only_new_keyframes_are_compared_and_former_ones_get_them_as_aliases() {
        let place = Place::new(&PlaceOptions { keyframes: 12, landmarks: 6000, ..PlaceOptions::default() });
        let mut once = place.map.clone();
        let mut searched = Vec::new();
        find_aliases(&mut once, &mut |stage, done, of| searched.push((stage, done, of))).unwrap();
        assert_eq!(searched.last(), Some(&(Stage::Aliasing, 12, 12)));
        assert!(once.aliases.len() == 12 && once.aliases.iter().all(|aliases| aliases.places.is_empty()));

        // The same place once more, 50 m beside it.
        let mut both = once.clone();
        add_copy_beside(&mut both, Vector3::new(0.0, 50.0, 0.0), [100, 1_000_000]);
        searched.clear();
        find_aliases(&mut both, &mut |stage, done, of| searched.push((stage, done, of))).unwrap();
        assert_eq!(searched.last(), Some(&(Stage::Aliasing, 12, 12)));
        both.validate().unwrap();
        let of =
            |keyframe: KeyframeId| both.aliases.iter().find(|aliases| aliases.keyframe == keyframe).unwrap();
        for keyframe in &place.map.keyframes {
            assert!(of(keyframe.id + 100).places.iter().all(|place| place.keyframe < 100));
            assert!(of(keyframe.id).places.iter().all(|place| place.keyframe >= 100));
        }
        let aliased = both.aliases.iter().filter(|aliases| aliases.log_odds() > Some(0.0)).count();
        assert!(aliased > 18, "{aliased} of 24");
        assert_eq!(both.aliases.iter().map(|aliases| aliases.keyframe).collect::<Vec<_>>().len(), 24);
    }
}
