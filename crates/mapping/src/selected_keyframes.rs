//! Keyframes that are selected, and their features extracted, on another thread while odometry gives their poses.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, channel};

use estimator::propagation::ImuState;
use geometry::uncertain_pose::PoseWithCovariance;
use sensors::{CameraSensor, Frame};

use super::camera::Rig;
use super::error::BuildError;
use super::feature_source::{Extraction, FeatureSource};
use super::keyframe_selection::{KeyframeSelector, is_in_time};
use super::keyframe_view::KeyframeView;
use super::odometry::local_prior;
use super::options::BuildOptions;
use super::progress::{Progress, Stage};

/// A frame and the pose of camera 0.
type Located = (Frame, PoseWithCovariance);

/// Keyframes that were selected while odometry ran, with their features.
#[derive(Debug)]
pub struct SelectedKeyframes {
    /// The keyframes, in order of time.
    pub(super) views: Vec<KeyframeView<'static>>,
    /// Images that could not be read, with the reason.
    pub(super) unreadable: Vec<String>,
}

/// Runs odometry, and selects keyframes on another thread as their poses become known.
///
/// # Arguments
/// * `sensors`: the cameras.
/// * `first_ns`: time of the first image of the recording.
/// * `odometry`: gets a callback for each image with its state, and one for its progress.
///
/// # Returns
/// What `odometry` returned, and the keyframes.
///
/// # Errors
/// [`BuildError`] of an image: the keyframes have it, and odometry ran to its end.
pub fn select_during<T>(
    sensors: &[CameraSensor],
    first_ns: i64,
    extraction: Extraction<'_>,
    options: &BuildOptions,
    progress: Progress<'_>,
    odometry: impl FnOnce(&mut dyn FnMut(&Frame, &ImuState), Progress<'_>) -> T,
) -> (T, Result<SelectedKeyframes, BuildError>) {
    let rig = &Rig::new(sensors, extraction.cameras);
    let (outbox, inbox) = channel::<Located>();
    let (counted, counts) = channel();
    std::thread::scope(|scope| {
        let selection = scope.spawn(move || {
            // The receiver waits for the end of this thread.
            let count = |done, all| {
                let _ = counted.send((done, all));
            };
            select(rig, extraction, options, &inbox, count)
        });
        let mut located = |frame: &Frame, state: &ImuState| {
            let has_image = rig.groups.iter().any(|group| frame.images.contains_key(&group.first));
            if !has_image || !is_in_time(frame.stamp_ns, first_ns, options) {
                return;
            }
            let prior = local_prior(frame.stamp_ns, state, &sensors[0], options);
            // The receiver is gone after an error, which the selection returns.
            let _ = outbox.send((frame.clone(), prior));
        };
        let of_odometry = odometry(&mut located, progress);
        drop(outbox);
        for (done, all) in counts {
            progress(Stage::KeyframeSelection, done, all);
        }
        let selected = selection.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        (of_odometry, selected)
    })
}

/// Selects keyframes among images that come in.
///
/// # Arguments
/// * `progress`: called with the number of images done and that of those that are known.
fn select(
    rig: &Rig,
    extraction: Extraction<'_>,
    options: &BuildOptions,
    inbox: &Receiver<Located>,
    progress: impl Fn(usize, usize),
) -> Result<SelectedKeyframes, BuildError> {
    let mut source = FeatureSource::new(Some(extraction), rig);
    let mut selector = KeyframeSelector::new(options);
    let mut views: Vec<KeyframeView<'static>> = Vec::new();
    let mut waiting: VecDeque<Located> = VecDeque::new();
    let mut done = 0;
    while let Some((frame, prior)) = waiting.pop_front().or_else(|| inbox.recv().ok()) {
        waiting.extend(inbox.try_iter());
        progress(done, done + 1 + waiting.len());
        done += 1;
        let later = waiting.iter().map(|(frame, prior)| (frame, prior));
        let view = selector.consider(&views, (&frame, &prior), later, &mut source)?;
        views.extend(view.map(KeyframeView::into_owned));
    }
    Ok(SelectedKeyframes { views, unreadable: source.unreadable })
}
