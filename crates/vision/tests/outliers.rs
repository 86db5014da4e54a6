//! Laws of the outlier rejection, on synthetic bearings.

use geometry::Rotation;
use geometry::rotation::{exp, log};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use vision::tracking::{BearingPair, Consensus, OutlierOptions, find_outliers};

/// A third of a pixel at a focal length of 460 px.
const NOISE: f64 = 0.3 / 460.0;

struct Scene {
    pairs: Vec<BearingPair>,
    wrong: Vec<bool>,
    rotation: Rotation,
}

/// Points 2 to 8 m in front of a camera that turns and moves; a share of the pairs is replaced by others.
fn scene(seed: u64, translation: Vector3<f64>, turn: Vector3<f64>, share: f64) -> Scene {
    let mut random = StdRng::seed_from_u64(seed);
    let rotation = exp(&turn);
    let mut scene = Scene { pairs: Vec::new(), wrong: Vec::new(), rotation };
    for _ in 0..150 {
        let mut noise = || Vector3::from_fn(|_, _| random.random_range(-1.7..1.7) * NOISE);
        let (noise_before, noise_after) = (noise(), noise());
        let depth = random.random_range(2.0..8.0);
        let point = Vector3::new(random.random_range(-0.7..0.7), random.random_range(-0.5..0.5), 1.0) * depth;
        let mut after = (rotation * point + translation).normalize();
        let wrong = random.random_bool(share);
        if wrong {
            // 5 to 20 px in any direction: some follow the epipolar line by chance.
            let angle = random.random_range(0.0..std::f64::consts::TAU);
            let length = random.random_range(5.0..20.0) / 460.0;
            after += Vector3::new(angle.cos(), angle.sin(), 0.0) * length;
        }
        let (previous, current) =
            ((point.normalize() + noise_before).normalize(), (after + noise_after).normalize());
        scene.pairs.push(BearingPair { previous, current });
        scene.wrong.push(wrong);
    }
    scene
}

impl Scene {
    /// Shares of right pairs that are kept and of wrong ones that are thrown out.
    fn judge(&self, consensus: &Consensus) -> (f64, f64) {
        let share = |wrong: bool, inlier: bool| {
            let of = self.wrong.iter().filter(|w| **w == wrong).count().max(1);
            let both = self.wrong.iter().zip(&consensus.inliers);
            both.filter(|(w, i)| **w == wrong && **i == inlier).count() as f64 / of as f64
        };
        (share(false, true), share(true, false))
    }
}

const MOTIONS: [[f64; 3]; 4] = [[0.1, 0.0, 0.0], [0.0, 0.0, -0.15], [0.05, -0.08, 0.05], [0.0, 0.2, 0.1]];
const TURN: Vector3<f64> = Vector3::new(0.02, -0.04, 0.03);

#[test]
fn with_the_rotation_two_points_separate_the_wrong_from_the_right() {
    for (seed, translation) in MOTIONS.iter().enumerate() {
        let scene = scene(seed as u64, Vector3::from(*translation), TURN, 0.3);
        let known = Some((&scene.rotation, 1e-3));
        let consensus = find_outliers(&scene.pairs, known, &OutlierOptions::default()).unwrap();
        let (kept, thrown) = scene.judge(&consensus);
        assert!(kept > 0.98, "kept {kept}");
        assert!(thrown > 0.7, "thrown out {thrown}");
        let direction = Vector3::from(*translation).normalize();
        assert!(consensus.pose.direction.dot(&direction) > 0.98, "the direction of motion is found");
    }
}

#[test]
fn without_it_five_points_do_and_find_the_rotation() {
    for (seed, translation) in MOTIONS.iter().enumerate() {
        let scene = scene(10 + seed as u64, Vector3::from(*translation), TURN, 0.2);
        let consensus = find_outliers(&scene.pairs, None, &OutlierOptions::default()).unwrap();
        let (kept, thrown) = scene.judge(&consensus);
        assert!(kept > 0.95, "kept {kept}");
        assert!(thrown > 0.6, "thrown out {thrown}");
        let off = log(&(consensus.pose.current_from_previous * scene.rotation.inverse())).norm();
        assert!(off < 3e-3, "the rotation is off by {off} rad");
    }
}

#[test]
fn standing_still_and_pure_turning_keep_everything_that_is_right() {
    for turn in [Vector3::zeros(), TURN] {
        for known in [true, false] {
            let scene = scene(20, Vector3::zeros(), turn, 0.2);
            let rotation = known.then_some((&scene.rotation, 1e-3));
            let consensus = find_outliers(&scene.pairs, rotation, &OutlierOptions::default()).unwrap();
            let (kept, thrown) = scene.judge(&consensus);
            assert!(kept > 0.98, "kept {kept} (rotation known: {known})");
            assert!(thrown > 0.6, "thrown out {thrown} (rotation known: {known})");
        }
    }
}

#[test]
fn a_gyroscope_with_a_bias_is_corrected() {
    // 0.08 rad/s over 0.05 s: 1.8 px, more than the threshold.
    let bias = Vector3::new(0.0025, -0.0025, 0.002);
    let mut left = Vector3::zeros();
    for (seed, translation) in MOTIONS.iter().cycle().take(12).enumerate() {
        let scene = scene(30 + seed as u64, Vector3::from(*translation), TURN, 0.1);
        let biased = exp(&bias) * scene.rotation;
        let known = Some((&biased, 5e-3));
        let consensus = find_outliers(&scene.pairs, known, &OutlierOptions::default()).unwrap();
        let (kept, _) = scene.judge(&consensus);
        assert!(kept > 0.9, "kept {kept}");
        left += log(&(consensus.pose.current_from_previous * scene.rotation.inverse())) / 12.0;
    }
    // A single pair of images tells turning from moving sideways only roughly; the mean does.
    assert!(left.norm() < 0.3 * bias.norm(), "{} rad are left of {}", left.norm(), bias.norm());
}

#[test]
fn same_seed_same_result_and_few_pairs_are_no_basis() {
    let scene = scene(40, Vector3::new(0.1, 0.0, 0.0), TURN, 0.3);
    let options = OutlierOptions::default();
    assert_eq!(find_outliers(&scene.pairs, None, &options), find_outliers(&scene.pairs, None, &options));
    assert!(find_outliers(&scene.pairs[..7], None, &options).is_none());
    assert!(find_outliers(&[], Some((&scene.rotation, 1e-3)), &options).is_none());
}
