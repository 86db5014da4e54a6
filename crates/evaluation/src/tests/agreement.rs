//! The same figures as `evo` 1.38 (API, `max_diff` 0.01 s) gave on the same two TUM files.

use super::*;
use crate::trajectory::tum;

/// Through the text of a TUM file, as `evo` saw it.
fn through_file(poses: &[StampedPose]) -> Vec<StampedPose> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.tum");
    tum::write(&path, poses).unwrap();
    tum::read(&path).unwrap()
}

fn positions(
    reference: &[StampedPose],
    estimate: &[StampedPose],
    pairs: &[Pair],
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let position =
        |pair: &Pair| (reference[pair.reference].pose.translation, estimate[pair.estimate].pose.translation);
    pairs.iter().map(position).collect()
}

fn assert_figures(found: &Statistics, [rmse, mean, median, std, min, max]: [f64; 6]) {
    for (found, expected) in [
        (found.rmse, rmse),
        (found.mean, mean),
        (found.median, median),
        (found.std, std),
        (found.min, min),
        (found.max, max),
    ] {
        assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
    }
}

#[test]
fn absolute_errors_agree_with_evo() {
    let (reference, estimate) = (through_file(&reference()), through_file(&estimate()));
    let pairs = associate(&reference, &estimate, 10_000_000);
    assert_eq!(pairs.len(), 171);
    let raw = absolute_errors(&reference, &estimate, &pairs, &Pose::identity());
    assert_figures(
        &raw.translation().unwrap(),
        [10.928_002_722, 10.628_108_673, 11.108_738_861, 2.542_547_843, 6.622_393_144, 14.766_681_340],
    );
    assert_figures(
        &raw.rotation().unwrap(),
        [40.144_199_342, 40.136_062_836, 40.190_407_222, 0.808_208_373, 38.804_928_582, 41.504_326_158],
    );
    let aligned = align(&positions(&reference, &estimate, &pairs), &Alignment::Se3).unwrap();
    let errors = absolute_errors(&reference, &estimate, &pairs, &aligned);
    assert_figures(
        &errors.translation().unwrap(),
        [0.050_706_295, 0.049_330_962, 0.050_913_594, 0.011_729_642, 0.016_275_503, 0.068_929_336],
    );
    assert_figures(
        &errors.rotation().unwrap(),
        [1.402_535_149, 1.369_961_322, 1.389_340_811, 0.300_517_586, 0.701_721_740, 1.855_469_256],
    );
}

#[test]
fn relative_errors_agree_with_evo() {
    let (reference, estimate) = (through_file(&reference()), through_file(&estimate()));
    let pairs = associate(&reference, &estimate, 10_000_000);
    let cases = [
        (
            Delta::Frames(1),
            [0.080_090_287, 0.077_026_544, 0.078_081_453, 0.021_940_046, 0.019_058_163, 0.131_293_104],
            [1.567_674_339, 1.482_997_120, 1.440_578_300, 0.508_254_244, 0.703_277_138, 3.035_606_379],
        ),
        (
            Delta::Frames(10),
            [0.097_852_476, 0.093_221_527, 0.089_944_196, 0.029_746_494, 0.034_294_559, 0.138_374_307],
            [2.107_270_101, 2.001_363_180, 2.064_388_262, 0.659_645_890, 0.600_997_825, 3.214_087_401],
        ),
        (
            Delta::Metres(2.0),
            [0.073_803_877, 0.069_914_770, 0.063_670_274, 0.023_641_851, 0.033_002_073, 0.123_789_884],
            [2.097_574_058, 1.997_672_732, 2.153_564_902, 0.639_625_345, 0.813_527_656, 3.226_034_051],
        ),
    ];
    for (delta, translation, rotation) in cases {
        let errors = relative_errors(&reference, &estimate, &pairs, delta);
        assert_figures(&errors.translation().unwrap(), translation);
        assert_figures(&errors.rotation().unwrap(), rotation);
    }
}

#[test]
fn segments_of_seconds_have_the_given_length() {
    let (reference, estimate) = (reference(), estimate());
    let pairs = associate(&reference, &estimate, 10_000_000);
    let errors = relative_errors(&reference, &estimate, &pairs, Delta::Seconds(1.0));
    // 10 s, in segments of 1 s that may overshoot by one missing pose.
    assert!((8..=9).contains(&errors.metres.len()), "{}", errors.metres.len());
}

#[test]
fn a_moved_copy_is_aligned_exactly() {
    let truth = reference();
    let gravity = Vector3::new(-1.0, 0.2, 0.1).normalize();
    let level = alignment::rotation_between(&gravity, &-Vector3::z());
    let yawed = Pose::new(level * rotation(0.0, 0.0, 2.5), Vector3::new(3.0, 4.0, -5.0));
    let tilted = Pose::new(rotation(0.4, -1.1, 2.0), Vector3::new(3.0, 4.0, -5.0));
    let about_gravity = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: -Vector3::z() };
    for (moved, alignment) in [(yawed, about_gravity), (yawed, Alignment::Se3), (tilted, Alignment::Se3)] {
        let pairs: Vec<_> = truth
            .iter()
            .map(|stamped| stamped.pose.translation)
            .map(|position| (position, moved.inverse_transform(&position)))
            .collect();
        assert!(align(&pairs, &alignment).unwrap().local(&moved).amax() < 1e-9);
    }
}

#[test]
fn about_gravity_no_small_turn_or_shift_is_better() {
    let (reference, estimate) = (reference(), estimate());
    let pairs = positions(&reference, &estimate, &associate(&reference, &estimate, 10_000_000));
    let gravity = -Vector3::z();
    let alignment = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
    let best = align(&pairs, &alignment).unwrap();
    let cost = |pose: &Pose| -> f64 {
        pairs.iter().map(|(reference, estimate)| (reference - pose.transform(estimate)).norm_squared()).sum()
    };
    for step in [1e-4, -1e-4] {
        let turned = Pose::new(best.rotation * rotation(0.0, 0.0, step), best.translation);
        assert!(cost(&turned) > cost(&best));
        for axis in 0..3 {
            let shifted = Pose::new(best.rotation, best.translation + Vector3::ith(axis, step));
            assert!(cost(&shifted) > cost(&best));
        }
    }
}

#[test]
fn what_cannot_be_aligned_is_refused() {
    assert_eq!(align(&[], &Alignment::Se3), Err(AlignmentError::NoPairs));
    let line: Vec<_> = (0..9).map(|i| Vector3::new(1.0, 2.0, 3.0) * f64::from(i)).map(|p| (p, p)).collect();
    assert_eq!(align(&line, &Alignment::Se3), Err(AlignmentError::Degenerate));
}

#[test]
fn association_takes_the_nearest_and_nothing_too_far() {
    let at = |stamp_ns| StampedPose { stamp_ns, pose: Pose::identity() };
    let few = [at(5), at(14), at(100)];
    let many = [at(0), at(10), at(20), at(30)];
    let pair = |reference, estimate| Pair { reference, estimate };
    assert_eq!(associate(&few, &many, 6), [pair(0, 0), pair(1, 1)]);
    assert_eq!(associate(&many, &few, 6), [pair(0, 0), pair(1, 1)]);
    assert!(associate(&[], &many, 6).is_empty());
}
