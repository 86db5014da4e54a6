//! The camera pose from all verified keyframes of a place together.
//!
//! The inlier threshold of verification is wide, so that maps whose landmarks are off by decimetres still match. Here
//! the matches show how precise the map is: the camera's pose in G and the errors of the keyframes' poses are estimated
//! jointly from every match of every verified keyframe, and the gate follows the median residual. In a precise map it
//! shrinks to a few pixels, in a coarse one it keeps its width.
//!
//! ```text
//! minimize over T, e:  sum_i w_i |z_i - pi(T^-1 T_k(e_k) p_i)|^2 / s^2  +  e^T P^-1 e
//! ```
//! with `T` the camera in G, `T_k(e_k)` the pose of keyframe `k` corrected by its error, `p_i` the landmark in that keyframe, and `P`
//! the covariance of all the errors, cross-covariances included. Writing `e = L x` with `P = L L^T` needs no inverse of
//! `P`, so a map may hold exact keyframes. The covariance of `T` is its block of the inverse normal matrix, so it holds
//! the uncertainty of the keyframes; errors of landmarks are assumed independent, with the
//! standard deviation of the residuals.
//!
//! A feature that several keyframes match counts once: each of its matches is weighted by one over their number. Weights are
//! Geman and McClure's, see Black & Rangarajan, IJCV 1996.

use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, Vector2, Vector6};

use super::loaded_map::LoadedMap;
use super::options::RecognitionOptions;
use super::verification::{Image, VerifiedKeyframe};

/// At most this many keyframes are fused, those with most inliers: further ones change the pose little, and the cost
/// grows with their number.
pub(crate) const MAX_FUSED_KEYFRAMES: usize = 6;
/// Gauss-Newton iterations; from verified poses 5 converge.
const MAX_ITERATIONS: usize = 10;
/// A step shorter than this (rad, m) ends the iteration.
const CONVERGED: f64 = 1e-7;
/// Median length of a two-dimensional normal error over its standard deviation.
const MEDIAN_OF_RAYLEIGH: f64 = 1.1774;
/// Residual, in standard deviations, beyond which a match is no inlier: 99.97 % of a normal error lie within.
const GATE_SIGMAS: f64 = 4.0;
/// Residual, in standard deviations, at which Geman and McClure's weight has fallen to a quarter.
const SOFT_SIGMAS: f64 = 3.0;
/// Focal lengths may be off by this part: landmarks of coarse maps are off by as much of their distance.
const MAX_FOCAL_ERROR: f64 = 0.05;
/// ... and by so many standard deviations of the estimate.
const FOCAL_SIGMAS: f64 = 6.0;
/// Lower bound of the residuals' scale, as a part of the stated pixel noise: few residuals can be small by chance.
const MIN_SCALE: f64 = 0.5;

/// A camera pose from several keyframes.
pub(crate) struct FusedPose {
    pub(crate) global_from_camera: PoseWithCovariance,
    /// Distinct query features within the gate.
    pub(crate) inliers: usize,
    /// Distinct query features that were matched.
    pub(crate) matched: usize,
    /// Mean reprojection error of the matches within the gate (px).
    pub(crate) mean_error_px: f64,
    /// How much longer the focal length is by the matches than by the camera.
    pub(crate) focal_error: Option<FocalError>,
}

/// The relative error of a focal length, from the residuals of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FocalError {
    /// The focal length that fits the residuals best, over that of the camera, minus one.
    pub(crate) relative: f64,
    /// Its standard deviation.
    pub(crate) sigma: f64,
}

impl FocalError {
    /// Whether the camera cannot be the one that took the image. A wrong focal length moves the pose by decimetres and
    /// leaves small residuals, so the covariance of the pose says nothing of it.
    pub(crate) fn contradicts_camera(&self) -> bool {
        self.relative.abs() > MAX_FOCAL_ERROR && self.relative.abs() > FOCAL_SIGMAS * self.sigma
    }
}

/// Fuses the verified keyframes of one place. Few inliers may be left where the matches fit no pose well: their number tells.
/// `None` where it fails numerically; then the pose of the best keyframe is used.
///
/// # Arguments
/// * `place`: not empty, most inliers first.
pub(crate) fn fuse(
    map: &LoadedMap,
    place: &[VerifiedKeyframe],
    image: &Image<'_>,
    options: &RecognitionOptions,
) -> Option<FusedPose> {
    let place = &place[..place.len().min(MAX_FUSED_KEYFRAMES)];
    let stated_sigma = options.sigma_query_px.hypot(map.info.sigma_px);
    let focal = f64::midpoint(image.camera.focal[0], image.camera.focal[1]);
    let problem = Problem {
        map,
        place,
        image,
        root: root_covariance(map, place),
        stated_sigma,
        max_gate: options.inlier_angle * focal,
    };
    let mut state = State {
        global_from_camera: place[0].global_from_camera.pose,
        errors: DVector::zeros(6 * place.len()),
        gate: problem.max_gate,
    };
    let mut normal = problem.linearize(&state)?;
    for _ in 0..MAX_ITERATIONS {
        let step = normal.information.clone().cholesky()?.solve(&normal.gradient);
        state.retract(&step, &problem.root);
        state.gate = normal.next_gate;
        normal = problem.linearize(&state)?;
        if step.rows(0, 6).norm() < CONVERGED {
            break;
        }
    }
    let focal_error = normal.focal_error();
    let covariance: Matrix6<f64> =
        normal.information.cholesky()?.inverse().fixed_view::<6, 6>(0, 0).into_owned();
    let covariance = (covariance + covariance.transpose()) * 0.5;
    let moved = place[0].global_from_camera.pose.local(&state.global_from_camera);
    let usable = covariance.iter().chain(moved.iter()).all(|value| value.is_finite());
    usable.then(|| FusedPose {
        global_from_camera: PoseWithCovariance::new(state.global_from_camera, covariance),
        inliers: normal.inliers,
        matched: normal.matched,
        mean_error_px: normal.mean_error_px,
        focal_error,
    })
}

/// `L` of the covariance `P = L L^T` of the errors of all keyframes, 6 each.
fn root_covariance(map: &LoadedMap, place: &[VerifiedKeyframe]) -> DMatrix<f64> {
    let size = 6 * place.len();
    let mut covariance = DMatrix::<f64>::zeros(size, size);
    for (row, a) in place.iter().enumerate() {
        let a = &map.poses.keyframes[a.keyframe];
        let own = &a.global_from_keyframe.covariance;
        covariance.fixed_view_mut::<6, 6>(6 * row, 6 * row).copy_from(own);
        for (column, b) in place.iter().enumerate().take(row) {
            let b = &map.poses.keyframes[b.keyframe];
            if let Some(block) = map.joint_covariance(a.id, b.id) {
                covariance.fixed_view_mut::<6, 6>(6 * row, 6 * column).copy_from(&block);
                covariance.fixed_view_mut::<6, 6>(6 * column, 6 * row).copy_from(&block.transpose());
            }
        }
    }
    let eigen = covariance.symmetric_eigen();
    // Pairwise cross-covariances need not be positive semi-definite together.
    let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    eigen.eigenvectors * DMatrix::from_diagonal(&roots)
}

struct State {
    global_from_camera: Pose,
    /// `[dtheta, dp]` in G of each keyframe.
    errors: DVector<f64>,
    /// Residual (px) up to which a match is an inlier.
    gate: f64,
}

impl State {
    /// Applies a step of the pose and of `x`, where the keyframes' errors are `root * x`.
    fn retract(&mut self, step: &DVector<f64>, root: &DMatrix<f64>) {
        let pose_step: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
        self.global_from_camera = self.global_from_camera.retract(&pose_step);
        self.errors += root * step.rows(6, step.len() - 6);
    }
}

struct Problem<'a> {
    map: &'a LoadedMap,
    place: &'a [VerifiedKeyframe],
    image: &'a Image<'a>,
    root: DMatrix<f64>,
    stated_sigma: f64,
    max_gate: f64,
}

/// The normal equations at one state, over the pose and `x`.
struct NormalEquations {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    next_gate: f64,
    inliers: usize,
    matched: usize,
    mean_error_px: f64,
    focal: FocalSums,
}

/// Sums over the weighted derivatives by the logarithm of the focal length.
struct FocalSums {
    information: f64,
    gradient: f64,
    /// With the pose and `x`.
    coupling: DVector<f64>,
}

impl NormalEquations {
    /// The error of the focal length, estimated together with the pose and the keyframes' errors; `None` where the
    /// matches do not determine it.
    fn focal_error(&self) -> Option<FocalError> {
        let cholesky = self.information.clone().cholesky()?;
        let by_coupling = cholesky.solve(&self.focal.coupling);
        let information = self.focal.information - self.focal.coupling.dot(&by_coupling);
        if information <= 0.0 {
            return None;
        }
        let relative = (self.focal.gradient - by_coupling.dot(&self.gradient)) / information;
        Some(FocalError { relative, sigma: information.sqrt().recip() })
    }
}

/// A match at one state.
struct MatchResidual {
    feature: usize,
    keyframe: usize,
    error: Vector2<f64>,
    length: f64,
    by_camera: SMatrix<f64, 2, 6>,
    by_keyframe: SMatrix<f64, 2, 6>,
    /// By the logarithm of the focal length (px).
    by_focal: Vector2<f64>,
}

impl Problem<'_> {
    fn residuals(&self, state: &State) -> Vec<MatchResidual> {
        let mut residuals = Vec::new();
        for (number, verified) in self.place.iter().enumerate() {
            let keyframe = &self.map.poses.keyframes[verified.keyframe];
            let pose_error: Vector6<f64> = state.errors.fixed_rows::<6>(6 * number).into_owned();
            let global_from_keyframe = keyframe.global_from_keyframe.pose.retract(&pose_error);
            for (found, point) in verified.matches.iter().zip(&verified.points) {
                let in_global = global_from_keyframe.transform(point);
                let in_camera = state.global_from_camera.inverse_transform(&in_global);
                let Ok((pixel, by_point)) = self.image.camera.project_with_jacobian(&in_camera) else {
                    continue;
                };
                let observed = Vector2::from(self.image.features.pixels[found.query].map(f64::from));
                let error = observed - pixel;
                let (by_pose, by_global) = state.global_from_camera.inverse_transform_jacobians(&in_global);
                let (by_error, _) = global_from_keyframe.transform_jacobians(point);
                residuals.push(MatchResidual {
                    feature: found.query,
                    keyframe: number,
                    error,
                    length: error.norm(),
                    by_camera: by_point * by_pose,
                    by_keyframe: by_point * by_global * by_error,
                    by_focal: pixel - Vector2::from(self.image.camera.centre),
                });
            }
        }
        residuals
    }

    fn linearize(&self, state: &State) -> Option<NormalEquations> {
        let residuals = self.residuals(state);
        let mut lengths: Vec<f64> =
            residuals.iter().map(|residual| residual.length).filter(|length| *length <= state.gate).collect();
        let mean_error_px = lengths.iter().sum::<f64>() / lengths.len() as f64;
        let median = geometry::median(&mut lengths)?;
        let scale = (median / MEDIAN_OF_RAYLEIGH).max(MIN_SCALE * self.stated_sigma);
        let sigma = scale.max(self.stated_sigma);

        // How often each feature is matched: at all, and within the gate.
        let mut pairs = vec![(false, 0_u32); self.image.features.len()];
        for residual in &residuals {
            pairs[residual.feature].0 = true;
            pairs[residual.feature].1 += u32::from(residual.length <= state.gate);
        }
        let count = self.place.len();
        let mut camera = Matrix6::zeros();
        let mut camera_gradient = Vector6::zeros();
        // Of each keyframe: its own block, its block with the camera, its gradient.
        let mut blocks = vec![(Matrix6::zeros(), Matrix6::zeros(), Vector6::zeros()); count];
        let (mut focal_information, mut focal_gradient) = (0.0, 0.0);
        let mut focal_with_camera = Vector6::zeros();
        let mut focal_with_keyframes = DVector::<f64>::zeros(6 * count);
        for residual in residuals.iter().filter(|residual| residual.length <= state.gate) {
            let softness = 1.0 + (residual.length / (SOFT_SIGMAS * scale)).powi(2);
            let weight = 1.0 / (softness.powi(2) * f64::from(pairs[residual.feature].1) * sigma.powi(2));
            camera += residual.by_camera.tr_mul(&residual.by_camera) * weight;
            camera_gradient += residual.by_camera.tr_mul(&residual.error) * weight;
            let (own, with_camera, gradient) = &mut blocks[residual.keyframe];
            *own += residual.by_keyframe.tr_mul(&residual.by_keyframe) * weight;
            *with_camera += residual.by_camera.tr_mul(&residual.by_keyframe) * weight;
            *gradient += residual.by_keyframe.tr_mul(&residual.error) * weight;
            focal_information += residual.by_focal.norm_squared() * weight;
            focal_gradient += residual.by_focal.dot(&residual.error) * weight;
            focal_with_camera += residual.by_camera.tr_mul(&residual.by_focal) * weight;
            let mut with_keyframe = focal_with_keyframes.fixed_rows_mut::<6>(6 * residual.keyframe);
            with_keyframe += residual.by_keyframe.tr_mul(&residual.by_focal) * weight;
        }
        let mut coupling = DVector::<f64>::zeros(6 + 6 * count);
        coupling.fixed_rows_mut::<6>(0).copy_from(&focal_with_camera);
        coupling.rows_mut(6, 6 * count).copy_from(&self.root.tr_mul(&focal_with_keyframes));
        let focal = FocalSums { information: focal_information, gradient: focal_gradient, coupling };

        let size = 6 * count;
        let mut own = DMatrix::<f64>::zeros(size, size);
        let mut with_camera = DMatrix::<f64>::zeros(6, size);
        let mut gradient = DVector::<f64>::zeros(size);
        for (at, block) in blocks.iter().enumerate() {
            own.fixed_view_mut::<6, 6>(6 * at, 6 * at).copy_from(&block.0);
            with_camera.fixed_view_mut::<6, 6>(0, 6 * at).copy_from(&block.1);
            gradient.fixed_rows_mut::<6>(6 * at).copy_from(&block.2);
        }
        let mut information = DMatrix::<f64>::identity(6 + size, 6 + size);
        information.fixed_view_mut::<6, 6>(0, 0).copy_from(&camera);
        let whitened_with_camera = &with_camera * &self.root;
        information.view_mut((0, 6), (6, size)).copy_from(&whitened_with_camera);
        information.view_mut((6, 0), (size, 6)).copy_from(&whitened_with_camera.transpose());
        let mut whitened = information.view_mut((6, 6), (size, size));
        whitened += self.root.tr_mul(&(own * &self.root));
        let mut whole_gradient = DVector::<f64>::zeros(6 + size);
        whole_gradient.fixed_rows_mut::<6>(0).copy_from(&camera_gradient);
        // The prior: x is zero-mean with unit covariance.
        let whitened_errors = self.whitened(&state.errors);
        whole_gradient.rows_mut(6, size).copy_from(&(self.root.tr_mul(&gradient) - whitened_errors));
        Some(NormalEquations {
            information,
            gradient: whole_gradient,
            next_gate: (GATE_SIGMAS * scale).min(self.max_gate),
            inliers: pairs.iter().filter(|pair| pair.1 > 0).count(),
            matched: pairs.iter().filter(|pair| pair.0).count(),
            mean_error_px,
            focal,
        })
    }

    /// `x` of errors `e = L x`; the columns of `L` are orthogonal.
    fn whitened(&self, errors: &DVector<f64>) -> DVector<f64> {
        let mut whitened = self.root.tr_mul(errors);
        for (value, column) in whitened.iter_mut().zip(self.root.column_iter()) {
            let squared = column.norm_squared();
            *value = if squared > 0.0 { *value / squared } else { 0.0 };
        }
        whitened
    }
}
