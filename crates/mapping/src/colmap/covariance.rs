//! The joint covariance of a COLMAP model's poses, from its own reprojection errors.
//!
//! The model is at the minimum of its reprojection errors. Their second derivative there, with the points eliminated, is
//! the information of the poses; it leaves the frame free, which the first image, the scale and gravity fix. The scale is
//! an observation of the distance between the two keyframes that are farthest apart, so that its error is common to all.

use super::frame::ColmapFrame;
use crate::joint_covariance::{FrameAndScale, JointCovariance, joint_covariance};
use crate::stored_poses::Posterior;
use adjustment::{
    LandmarkBlocks, LandmarkEquations, NormalEquations, StateLayout, gauge_information, parallel,
};
use geometry::Pose;
use geometry::camera::Camera;
use geometry::rotation::skew;
use nalgebra::{
    Matrix2x3, Matrix2x6, Matrix6, Matrix6x3, RowVector3, RowVector6, Vector1, Vector2, Vector3, Vector6,
};

/// Standard deviations that fix the frame: of yaw (rad), of the tilt where gravity says none (rad), and of the position
/// (m) of the first image.
const GAUGE_SIGMAS: [f64; 3] = [1e-4, 1e-3, 1e-3];
/// Information of a weak prior on the inverse depth of a point in one of its images (m^2), as the adjuster of maps has it.
const DEPTH_INFORMATION: f64 = 1.0;
/// Points whose equations are summed up by one thread.
const RUN: usize = 512;

/// A point and the images that see it.
pub(super) struct Point {
    /// Id in the model.
    pub(super) id: u64,
    /// Position in G (m).
    pub(super) position: Vector3<f64>,
    /// View, index of its pixel there, and the pixel.
    pub(super) seen: Vec<(usize, usize, Vector2<f64>)>,
}

/// An image: its camera and pose in G (m).
pub(super) struct View {
    pub(super) camera: Camera,
    pub(super) pose: Pose,
}

impl View {
    fn in_camera(&self, position: &Vector3<f64>) -> Vector3<f64> {
        self.pose.inverse_transform(position)
    }

    /// Reprojection error (px), infinite where the point is not visible.
    pub(super) fn error(&self, position: &Vector3<f64>, pixel: &Vector2<f64>) -> f64 {
        self.camera.project(&self.in_camera(position)).map_or(f64::INFINITY, |at| (at - pixel).norm())
    }

    /// Jacobians of the pixel by the pose's error `[δθ, δp]` in G and by the position of the point.
    ///
    /// ```text
    /// d = R^T (x - p),   dd/dtheta = R^T [x - p]x,   dd/dp = -R^T,   dd/dx = R^T
    /// ```
    fn jacobians(&self, position: &Vector3<f64>) -> Option<(Matrix2x6<f64>, Matrix2x3<f64>)> {
        let (_, by_camera) = self.camera.project_with_jacobian(&self.in_camera(position)).ok()?;
        let by_point = by_camera * self.pose.rotation.inverse().to_rotation_matrix().matrix();
        let mut by_pose = Matrix2x6::zeros();
        let by_rotation = by_point * skew(&(position - self.pose.translation));
        by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&by_rotation);
        by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_point);
        Some((by_pose, by_point))
    }

    /// Jacobians of the inverse depth of a point, `d.z^-1`, by the pose's error and by the position of the point; `None` of a point that
    /// is not in front.
    fn inverse_depth_jacobians(&self, position: &Vector3<f64>) -> Option<(RowVector6<f64>, RowVector3<f64>)> {
        let depth = self.in_camera(position).z;
        if depth <= 0.0 {
            return None;
        }
        let axis = self.pose.rotation * Vector3::z();
        let by_point = axis.transpose() * -depth.powi(-2);
        let mut by_pose = RowVector6::zeros();
        let by_rotation = by_point * skew(&(position - self.pose.translation));
        by_pose.fixed_view_mut::<1, 3>(0, 0).copy_from(&by_rotation);
        by_pose.fixed_view_mut::<1, 3>(0, 3).copy_from(&-by_point);
        Some((by_pose, by_point))
    }
}

/// The joint covariance of all views.
///
/// # Arguments
/// * `sigma_px`: standard deviation of a pixel (px).
///
/// # Returns
/// `None` where the points do not determine the poses.
pub(super) fn covariance(
    views: &[View],
    points: &[Point],
    frame: &ColmapFrame,
    sigma_px: f64,
    progress: impl FnMut(usize, usize),
) -> Option<JointCovariance> {
    let layout = StateLayout { views: views.len(), motions: 0 };
    let mut equations = NormalEquations::new(layout);
    add_frame(&mut equations, layout, views, frame);
    let of_run = |run: &[Point]| of_points(views, run, sigma_px);
    parallel::for_each_run(points, RUN, of_run, |run| equations.add_landmarks(run));
    let covariance = equations.covariance()?;
    let positions: Vec<_> = views.iter().map(|view| view.pose.translation).collect();
    let all: Vec<usize> = (0..views.len()).collect();
    let posterior = Posterior::new(&covariance, &[], &all, &[]);
    let as_adjusted = FrameAndScale::AsAdjusted;
    Some(joint_covariance(&posterior, (&all, all.len()), &positions, as_adjusted, progress))
}

fn of_points(views: &[View], points: &[Point], sigma_px: f64) -> LandmarkEquations {
    let seen_from = points.iter().flat_map(|point| point.seen.iter().map(|&(view, ..)| view));
    let mut equations = LandmarkEquations::new(seen_from);
    for point in points {
        add_point(&mut equations, views, point, sigma_px);
    }
    equations
}

fn add_point(equations: &mut LandmarkEquations, views: &[View], point: &Point, sigma_px: f64) {
    let weight = sigma_px.powi(-2);
    let mut blocks = LandmarkBlocks::default();
    for &(view, ..) in &point.seen {
        let Some((by_pose, by_point)) = views[view].jacobians(&point.position) else { continue };
        let weighted = by_pose.transpose() * weight;
        blocks.poses.push((view, weighted * by_pose, Vector6::zeros()));
        let coupling: Matrix6x3<f64> = weighted * by_point;
        blocks.couplings.push((view, coupling));
        blocks.information += by_point.transpose() * by_point * weight;
    }
    add_weak_depth(&mut blocks, views, point);
    equations.add_landmark(&blocks);
}

/// A weak prior of the depth in the image that anchors the landmark: a point without parallax would have none, and what its images
/// say of the poses would be lost with it.
fn add_weak_depth(blocks: &mut LandmarkBlocks, views: &[View], point: &Point) {
    let Some(&(view, ..)) = point.seen.get(point.seen.len() / 2) else { return };
    let Some((by_pose, by_point)) = views[view].inverse_depth_jacobians(&point.position) else { return };
    let weighted: Vector6<f64> = by_pose.transpose() * DEPTH_INFORMATION;
    blocks.poses.push((view, weighted * by_pose, Vector6::zeros()));
    blocks.couplings.push((view, weighted * by_point));
    blocks.information += by_point.transpose() * by_point * DEPTH_INFORMATION;
}

/// What fixes the frame: the first view, with the tilt that gravity leaves, and the scale.
fn add_frame(equations: &mut NormalEquations, layout: StateLayout, views: &[View], frame: &ColmapFrame) {
    let [sigma_yaw, sigma_tilt, sigma_p] = GAUGE_SIGMAS;
    let sigma_tilt = frame.gravity.as_ref().map_or(sigma_tilt, |gravity| gravity.sigma_rad.max(sigma_tilt));
    let up = frame.gravity.as_ref().map_or(Vector3::z(), |gravity| -gravity.in_global);
    let global_from_upright =
        nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &up).unwrap_or_else(|| {
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
    let turn = global_from_upright.to_rotation_matrix();
    let mut information = gauge_information(sigma_yaw, sigma_tilt, sigma_p);
    let turned = turn.matrix() * information.fixed_view::<3, 3>(0, 0) * turn.matrix().transpose();
    information.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned);
    equations.add_residual(layout.pose(0), &Matrix6::identity(), &information, &Vector6::zeros());
    let Some((a, b)) = farthest(views) else { return };
    let apart = views[b].pose.translation - views[a].pose.translation;
    let direction = apart.normalize();
    let mut jacobian = RowVector6::zeros();
    jacobian.fixed_view_mut::<1, 3>(0, 0).copy_from(&-direction.transpose());
    jacobian.fixed_view_mut::<1, 3>(0, 3).copy_from(&direction.transpose());
    let sigma = (frame.sigma_scale * apart.norm()).max(1e-6);
    let position = |view: usize| layout.pose(view).skip(3);
    equations.add_residual(
        position(a).chain(position(b)),
        &jacobian,
        &Vector1::new(sigma.powi(-2)),
        &Vector1::zeros(),
    );
}

/// Two views that are far apart: the farthest from the first, and the farthest from that one.
fn farthest(views: &[View]) -> Option<(usize, usize)> {
    let distance = |a: usize, b: usize| (views[a].pose.translation - views[b].pose.translation).norm();
    let from = |a: usize| (0..views.len()).max_by(|x, y| distance(a, *x).total_cmp(&distance(a, *y)));
    let a = from(0)?;
    let b = from(a)?;
    (distance(a, b) > 0.0).then_some((a, b))
}
