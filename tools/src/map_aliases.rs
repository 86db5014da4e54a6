//! Which keyframes of a map could be taken for another place of it.

use std::collections::BTreeMap;

use indicatif::ProgressBar;
use map::contents::MapContents;
use nalgebra::Vector3;
use protocol::KeyframeId;
use recognition::{LoadedMap, likely_alias};
use serde::Serialize;

/// How much of a map looks like other parts of it.
#[derive(Serialize)]
pub struct MapAliases {
    /// Keyframes whose images were compared with the rest of the map.
    pub compared: usize,
    /// How many views that do not overlap the map has.
    pub views: f64,
    /// Those of them that another place explains as well.
    pub aliased_views: f64,
    /// Natural logarithm of the odds of the right place over one that looks alike, before an image is seen.
    pub log_prior_odds: f64,
    /// All keyframes that could be taken for another place.
    pub keyframes: Vec<AliasedKeyframe>,
}

/// A keyframe that could be taken for another place.
#[derive(Serialize)]
pub struct AliasedKeyframe {
    /// Its id.
    pub keyframe: KeyframeId,
    /// Where it is in G, m.
    pub position_m: [f64; 3],
    /// The keyframe next to the place that it could be taken for.
    pub other: KeyframeId,
    /// Where that is in G, m.
    pub other_position_m: [f64; 3],
    /// Natural logarithm of the odds of the other place by the image alone.
    pub log_odds: f64,
}

impl MapAliases {
    /// Takes what the map states. Keyframes of which it states nothing are compared with all others.
    ///
    /// # Errors
    /// Contents that are not a map.
    pub fn of(mut contents: MapContents, bar: &ProgressBar) -> anyhow::Result<Self> {
        mapping::find_aliases(&mut contents, &mut |_, done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        let positions: BTreeMap<KeyframeId, Vector3<f64>> = contents
            .keyframes
            .iter()
            .map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose.translation))
            .collect();
        let mut keyframes = Vec::new();
        for aliases in &contents.aliases {
            let Some(other) = likely_alias(aliases) else { continue };
            keyframes.push(AliasedKeyframe {
                keyframe: aliases.keyframe,
                position_m: positions[&aliases.keyframe].into(),
                other: other.keyframe,
                other_position_m: positions[&other.keyframe].into(),
                log_odds: other.log_odds,
            });
        }
        let compared = contents.aliases.len();
        let rate = LoadedMap::from_contents(contents)?.aliasing_rate();
        Ok(Self {
            compared,
            views: rate.views,
            aliased_views: rate.aliased,
            log_prior_odds: rate.log_odds(),
            keyframes,
        })
    }

    /// Prints them as lines of a summary.
    pub fn print(&self) {
        println!(
            "aliasing                 {:.1} of {:.1} views look like another place; odds of an answer {:.1}, before the image is \
             seen",
            self.aliased_views,
            self.views,
            self.log_prior_odds.exp()
        );
        println!("  aliased keyframes      {} of {}", self.keyframes.len(), self.compared);
        for aliased in &self.keyframes {
            let [x, y, z] = aliased.position_m;
            let [other_x, other_y, other_z] = aliased.other_position_m;
            println!(
                "  {:<22} at ({x:.2}, {y:.2}, {z:.2}) m looks like {} at ({other_x:.2}, {other_y:.2}, {other_z:.2}) m: log-odds {:.1}",
                aliased.keyframe, aliased.other, aliased.log_odds
            );
        }
    }
}
