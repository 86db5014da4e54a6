//! A session that is worked into a part of a map, and into the map as a whole.

use std::collections::BTreeMap;

use map::MapContents;
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, run_odometry};
use simulation::{ChangingPlace, Scenario, SimulationOptions};
use testing::add_second_kind;

use super::{DAY_NS, FIRST_NS};
use crate::session::take_session_by_parts;
use crate::settings::Settings;

#[test]
fn a_part_that_is_the_whole_map_gives_the_same_map() {
    let options = SimulationOptions {
        scenario: Scenario::Room,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(12.0),
        landmarks_per_metre: 6.0,
        max_features: 150,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    let mut place = ChangingPlace::new(&options).unwrap();
    let mut first = place.record(1, FIRST_NS).unwrap();
    let odometry = run_odometry(&mut first, 2, |_, _| {}).unwrap();
    let (build, none) = (BuildOptions::default(), PosePriors::default());
    let mut map =
        build_map_from_odometry(&first, &odometry, &none, None, &build, &mut |_, _, _| {}).unwrap().0;
    add_second_kind(&mut map, "other-1");
    place.move_landmarks(0.1, 1);
    let session = place.record(2, FIRST_NS + DAY_NS).unwrap();

    let taken = |large: usize| {
        let (mut map, mut session, settings) = (map.clone(), session.clone(), Settings::default());
        let report =
            take_session_by_parts(&mut map, &mut session, &build, &settings, large, &mut |_, _, _| {})
                .unwrap();
        (map, report)
    };
    let [(whole, of_whole), (by_parts, of_parts)] = [usize::MAX, 0].map(taken);
    by_parts.validate().unwrap();
    assert_eq!(by_parts.audit_sessions(), Vec::new());
    assert!(of_whole.kept_keyframes > 0 && of_whole.seen > 50, "{of_whole:?}");
    let counts = |map: &MapContents| (map.keyframes.len(), map.landmarks.len(), map.observation_count());
    assert_eq!(counts(&by_parts), counts(&whole));
    assert_eq!((of_parts.keyframes, of_parts.landmarks), (of_whole.keyframes, of_whole.landmarks));
    // What is worked on as a whole has its covariances stated anew, with a lower bound added.
    for (a, b) in by_parts.keyframes.iter().zip(&whole.keyframes) {
        let [a, b] = [a, b].map(|keyframe| (keyframe.id, keyframe.global_from_keyframe));
        assert_eq!((a.0, a.1.pose), (b.0, b.1.pose));
        assert!((a.1.covariance - b.1.covariance).amax() < 3e-10, "{} {}", a.1.covariance, b.1.covariance);
    }
    // Of added kinds everything is where it was, with ids beyond the new ones.
    assert_eq!(by_parts.added_features[0].landmarks.len(), whole.added_features[0].landmarks.len());
    let pixels = |map: &MapContents| -> BTreeMap<_, _> {
        let landmarks = map.added_features.iter().flat_map(|added| &added.landmarks);
        let seen =
            landmarks.flat_map(|landmark| landmark.observations.iter().map(move |seen| (landmark, seen)));
        seen.map(|(landmark, seen)| ((seen.keyframe, seen.pixel.map(f32::to_bits)), landmark.clone()))
            .collect()
    };
    let before = pixels(&map);
    for map in [&by_parts, &whole] {
        let after = pixels(map);
        assert!(after.len() > 100 && after.len() <= before.len(), "{} of {}", after.len(), before.len());
        for (seen, landmark) in after {
            let was = &before[&seen];
            assert!(was.anchor != landmark.anchor || was.position_in_anchor == landmark.position_in_anchor);
        }
    }
    assert_eq!(by_parts.existence, whole.existence);
    for (a, b) in by_parts.landmarks_in_global().zip(whole.landmarks_in_global()) {
        assert!(a.0.id == b.0.id && (a.1 - b.1).norm() < 1e-8);
    }
    let pairs = by_parts.cross_covariances.iter().zip(&whole.cross_covariances);
    assert_eq!(by_parts.cross_covariances.len(), whole.cross_covariances.len());
    for (a, b) in pairs {
        assert_eq!((a.a, a.b), (b.a, b.b));
        assert!((a.block - b.block).amax() < 3e-10, "{} {}", a.block, b.block);
    }
    // Places that look alike are searched in all of the map.
    assert_eq!(by_parts.aliases.len(), by_parts.keyframes.len());
}
