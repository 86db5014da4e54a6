//! The map of the first flight.

use crate::demo::{CREATED_BY, GRAVITY_IN_GLOBAL};
use anyhow::{Context as _, Result};
use evaluation::{Alignment, align};
use geometry::Pose;
use map::MapContents;
use map::model::Keyframe;
use map::store::save_map;
use mapping::run_odometry;
use mapping::{BuildOptions, Extraction, PosePriors, Stage, build_map_from_odometry};
use nalgebra::Vector3;
use sensors::{Sequence, TruthTrack};
use serde::Serialize;
use std::path::Path;
use vision::features::{DEFAULT_EXTRACTOR, open};

/// Most features of an image.
const MAX_FEATURES: usize = 1000;

/// Figures of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapFigures {
    /// Keyframes.
    pub keyframes: usize,
    /// Landmarks.
    pub landmarks: usize,
    /// Places that were seen again and tied the map together.
    pub loops: usize,
    /// Root mean square of the keyframes' position errors, metres.
    pub rmse_m: f64,
    /// The same of the standard deviations that the map states, all axes together, metres.
    pub sigma_m: f64,
}

/// The map of the first flight.
pub(super) struct MappedRoom {
    /// Its figures.
    pub(super) figures: MapFigures,
    /// Positions of its keyframes, metres in G.
    pub(super) keyframes: Vec<Vector3<f64>>,
    /// From the room's frame, in which the truth is simulated.
    global_from_room: Pose,
}

impl MappedRoom {
    /// Builds the map of a flight without reference poses, and stores it.
    pub(super) fn build(
        mut flight: Sequence,
        database: &Path,
        progress: &mut dyn FnMut(&str),
    ) -> Result<Self> {
        let cameras = flight.cameras.len();
        let mut show = |stage: Stage, done: usize, all: usize| {
            progress(&format!("building the map: {}, {done} of {all}", stage.label()));
        };
        let odometry = run_odometry(&mut flight, cameras, |done, all| show(Stage::Odometry, done, all))?;
        let mut extractor = open(DEFAULT_EXTRACTOR, None)?;
        let extraction = Extraction {
            extractor: extractor.as_mut(),
            others: &mut [],
            max_features: MAX_FEATURES,
            masks: &[],
            cameras,
        };
        let mut options = BuildOptions::default();
        options.name = String::from("room");
        options.created_by = String::from(CREATED_BY);
        options.gravity_in_global = Some(GRAVITY_IN_GLOBAL);
        options.sigma_px = None;
        let priors = PosePriors::default();
        let (contents, report) =
            build_map_from_odometry(&flight, &odometry, &priors, Some(extraction), &options, &mut show)?;
        save_map(database, &contents, true)?;
        let errors =
            errors_in_own_frame(&flight, &contents).context("the map has no keyframe with a true pose")?;
        let root_mean = |squares: f64| (squares / contents.keyframes.len() as f64).sqrt();
        let figures = MapFigures {
            keyframes: report.keyframes,
            landmarks: report.landmarks,
            loops: report.loops - report.refused_loops,
            rmse_m: root_mean(errors.squares),
            sigma_m: root_mean(errors.variances),
        };
        let position = |keyframe: &Keyframe| keyframe.global_from_keyframe.pose.translation;
        let keyframes = contents.keyframes.iter().map(position).collect();
        Ok(Self { figures, keyframes, global_from_room: errors.global_from_room })
    }

    /// Moves the ground truth of a recording from the room's frame to that of the map.
    pub(super) fn place_truth(&self, sequence: &mut Sequence) {
        for row in sequence.groundtruth.iter_mut().flatten() {
            row.pose = self.global_from_room.compose(&row.pose);
            row.velocity = row.velocity.map(|velocity| self.global_from_room.rotation * velocity);
        }
    }
}

/// Errors of the keyframes' positions.
struct MapErrors {
    global_from_room: Pose,
    /// Sum of the squared distances from the truth, m^2.
    squares: f64,
    /// Sum of the variances that the map states, m^2.
    variances: f64,
}

/// The errors of a map in its own frame: the truth is aligned in yaw and position by all keyframes, as the map's covariance is relative
/// to them as a whole.
fn errors_in_own_frame(flight: &Sequence, contents: &MapContents) -> Option<MapErrors> {
    let track = TruthTrack::new(flight.groundtruth.as_deref()?);
    let imu_from_camera = flight.cameras[0].imu_from_camera;
    let true_camera = |stamp_ns: i64| Some(track.pose(stamp_ns, 0)?.compose(&imu_from_camera));
    let positions = |keyframe: &Keyframe| {
        let truth = true_camera(keyframe.stamp_ns)?.translation;
        Some((keyframe.global_from_keyframe.pose.translation, truth))
    };
    let pairs: Vec<_> = contents.keyframes.iter().map(positions).collect::<Option<_>>()?;
    let yaw = Alignment::Yaw {
        gravity_in_reference: contents.info.gravity_in_global.unwrap_or(GRAVITY_IN_GLOBAL),
        gravity_in_estimate: GRAVITY_IN_GLOBAL,
    };
    let global_from_room = align(&pairs, &yaw).ok()?;
    let (mut squares, mut variances) = (0.0, 0.0);
    for ((estimate, truth), keyframe) in pairs.iter().zip(&contents.keyframes) {
        squares += (estimate - global_from_room.transform(truth)).norm_squared();
        variances += keyframe.global_from_keyframe.covariance.fixed_view::<3, 3>(3, 3).trace();
    }
    Some(MapErrors { global_from_room, squares, variances })
}
