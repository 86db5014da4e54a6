//! The notice of a new version of a map; what changed is the work of [`map::difference`].

use map::difference::VersionChange;
use protocol::{CodecError, Format, MapChangeNotice, StatedChange, keys};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;

use crate::error::ServeError;
use recognition::LoadedMap;
use releases::change::with_largest;

/// The notice of a new version, with the size of the motion computed from the keyframes.
///
/// # Returns
/// The notice, and the number of new keyframes, which robots need not know.
pub(crate) fn between(name: &str, old: &LoadedMap, new: &LoadedMap) -> (MapChangeNotice, usize) {
    let change = VersionChange::between(&old.compared(), &new.compared(), 0);
    let notice = MapChangeNotice {
        map: name.to_owned(),
        identity: new.identity(),
        from_version: old.info().version,
        version: new.info().version,
        changed: change.changed,
        moved: change.moved,
        removed: change.removed,
        stated_change: change.stated_change,
        keyframe_motions: change.keyframe_motions,
    };
    (notice, change.added.len())
}

/// Tells robots of a new version. A notice that is too long for one message tells them only the largest motion of a keyframe, as if all had
/// moved by so much; one that is still too long, only that there is a new version.
pub(crate) async fn publish(session: &Session, mut notice: MapChangeNotice) -> Result<(), ServeError> {
    let key = keys::map_changes(&notice.map)?;
    let encoded = |notice: &MapChangeNotice| match protocol::encode(Format::Bincode, notice) {
        Err(CodecError::TooLong { .. }) => Ok(None),
        payload => payload.map(Some),
    };
    let mut payload = encoded(&notice)?;
    if payload.is_none() {
        notice = without_motions(notice);
        payload = encoded(&notice)?;
    }
    let payload = if let Some(payload) = payload {
        payload
    } else {
        let (changed, moved, removed) = (Vec::new(), Vec::new(), Vec::new());
        let short = MapChangeNotice { changed, moved, removed, stated_change: None, ..notice };
        protocol::encode(Format::Bincode, &short)?
    };
    let publication = session.put(key, payload).encoding(Encoding::from(Format::Bincode.encoding()));
    publication.congestion_control(CongestionControl::Block).await?;
    Ok(())
}

/// The notice with the largest motion of a keyframe in place of all motions: that of the map as a whole is far smaller than that of a
/// corner which moved.
fn without_motions(notice: MapChangeNotice) -> MapChangeNotice {
    let stated_change = notice.stated_change.map(|stated| with_largest(stated, &notice.keyframe_motions));
    MapChangeNotice { keyframe_motions: Vec::new(), stated_change, ..notice }
}

/// The size of a change, for a person.
pub(crate) fn describe(change: Option<&StatedChange>) -> String {
    match change {
        Some(StatedChange { sigma_theta_rad, sigma_p_m }) => {
            format!("{:.3} deg, {sigma_p_m:.3} m per axis", sigma_theta_rad.to_degrees())
        }
        None => "unknown: no keyframe is in both versions".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use geometry::{Camera, Distortion, Pose, PoseWithCovariance, rotation};
    use nalgebra::{Matrix6, Matrix6xX, Vector3};
    use protocol::DescriptorKind;

    use super::*;
    use map::contents::MapContents;
    use map::model::{CommonError, Keyframe, KeyframeCrossCovariance, MapMetadata};

    fn camera() -> Camera {
        Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        }
    }

    /// Keyframes along a trajectory of 40 m, far from the origin; neighbours are correlated.
    fn contents(version: u64, keyframes: u64) -> MapContents {
        let keyframe = |id: u64| {
            let along = id as f64;
            let turn = rotation::exp(&Vector3::new(0.1, 0.05 * along, -0.3));
            let pose = Pose::new(turn, Vector3::new(100.0 + 2.0 * along, -50.0, 0.1 * along));
            Keyframe {
                id,
                stamp_ns: 0,
                global_from_keyframe: PoseWithCovariance::new(pose, Matrix6::identity() * 1e-2),
                camera: camera(),
                features: None,
            }
        };
        let cross = |id: u64| KeyframeCrossCovariance { a: id, b: id + 1, block: Matrix6::identity() * 3e-3 };
        let info = MapMetadata { version, ..MapMetadata::new("hall", "test", DescriptorKind::Binary, 32) };
        MapContents {
            keyframes: (0..keyframes).map(keyframe).collect(),
            cross_covariances: (0..keyframes - 1).map(cross).collect(),
            ..MapContents::empty(info)
        }
    }

    fn change(old: MapContents, new: MapContents) -> MapChangeNotice {
        let [old, new] = [old, new].map(|contents| LoadedMap::from_contents(contents).unwrap());
        between("hall", &old, &new).0
    }

    /// Rotation (rad) and distance (m) of the three axes together.
    fn size(change: &MapChangeNotice) -> (f64, f64) {
        let stated = change.stated_change.unwrap();
        (stated.sigma_theta_rad * 3_f64.sqrt(), stated.sigma_p_m * 3_f64.sqrt())
    }

    #[test]
    fn a_move_of_the_whole_map_is_stated_with_its_size_at_the_keyframes() {
        let old = contents(4, 20);
        let middle = Vector3::new(119.0, -50.0, 0.95);
        for (turn, shift) in [(0.0, 0.3), (0.02, 0.0), (0.02, 0.3)] {
            let turn_by = rotation::exp(&(Vector3::new(1.0, -2.0, 2.0) / 3.0 * turn));
            let shift_by = Vector3::new(2.0, 1.0, -2.0) / 3.0 * shift;
            let mut new = contents(5, 20);
            for keyframe in &mut new.keyframes {
                let pose = &mut keyframe.global_from_keyframe.pose;
                let place = middle + turn_by * (pose.translation - middle) + shift_by;
                *pose = Pose::new(turn_by * pose.rotation, place);
            }
            let change = change(old.clone(), new);
            let (angle, distance) = size(&change);
            assert!((angle - turn).abs() < 1e-9, "{angle} rad of {turn}");
            // About the middle of the keyframes: a turn moves them beside the shift, by up to 20 m times its angle.
            assert!(distance >= shift - 1e-9, "{distance} m of {shift}");
            assert!(distance <= shift + turn * 20.0, "{distance} m of {shift}: the origin's lever is in it");
            assert_eq!((change.from_version, change.version), (4, 5));
            assert_eq!(change.moved, (0..20).collect::<Vec<_>>());
        }
    }

    #[test]
    fn adding_and_removing_keyframes_moves_none() {
        let added = change(contents(1, 10), contents(2, 14));
        assert!(size(&added).0 < 1e-12 && size(&added).1 == 0.0);
        assert!(added.changed.is_empty() && added.moved.is_empty() && added.removed.is_empty());
        let removed = change(contents(2, 14), contents(3, 10));
        assert!(size(&removed).0 < 1e-12 && size(&removed).1 == 0.0);
        assert_eq!((removed.moved.len(), removed.removed), (0, (10..14).collect::<Vec<_>>()));
    }

    #[test]
    fn a_keyframe_with_another_error_has_moved_and_one_that_was_only_rounded_has_not() {
        let mut new = contents(2, 10);
        new.keyframes[1].global_from_keyframe.pose.translation.x += 1e-9;
        new.keyframes[2].camera.focal[0] += 1.0;
        new.keyframes[4].global_from_keyframe.covariance *= 1.5;
        new.cross_covariances[7].block *= 0.5;
        let change = change(contents(1, 10), new);
        assert_eq!(change.moved, [4, 7, 8]);
        assert_eq!(change.changed, [2, 4, 7, 8]);
    }

    #[test]
    fn where_one_has_another_common_error_all_have_moved() {
        let [mut old, mut new] = [1, 2].map(|version| contents(version, 10));
        for (map, scale) in [(&mut old, 1.0), (&mut new, 1.0 + 1e-9)] {
            map.common_errors = (0..10)
                .map(|keyframe| CommonError { keyframe, factor: Matrix6xX::repeat(2, 1e-3 * scale) })
                .collect();
        }
        old.common_errors.remove(5);
        new.common_errors.remove(5);
        assert_eq!(change(old.clone(), new.clone()).moved, [0; 0]);
        new.common_errors.remove(3);
        assert_eq!(change(old.clone(), new.clone()).moved, [0, 1, 2, 3, 4, 6, 7, 8, 9]);
        new.common_errors[6].factor *= -1.0;
        let change = change(old, new);
        assert_eq!(change.moved, [0, 1, 2, 3, 4, 6, 7, 8, 9]);
        assert_eq!(change.changed, change.moved);
    }

    #[test]
    fn without_a_common_keyframe_nothing_is_stated() {
        let mut new = contents(2, 3);
        for keyframe in &mut new.keyframes {
            keyframe.id += 100;
        }
        new.cross_covariances.clear();
        let change = change(contents(1, 3), new);
        assert_eq!((change.stated_change, change.removed), (None, vec![0, 1, 2]));
    }
}
