//! The image of a query, from a file or from a recording, with its features.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use geometry::{Camera, Pose};
use onboard::arguments::FeatureArguments;
use protocol::{FeatureSet, LocalizeRequest};
use sensors::{CalibrationFiles, Frame, ImageData, Sequence, camera_groups};
use vision::{GrayImage, feature_set};

use map_io::text::read_camera;

/// An image to localize.
#[derive(Clone, Debug)]
pub struct QueryImage {
    /// The file, or the recording and the time in it.
    pub name: String,
    /// The camera that took it.
    pub camera: Camera,
    /// The image itself; `None` for a recording that has only features.
    pub image: Option<GrayImage>,
    /// Its features.
    pub features: FeatureSet,
}

impl QueryImage {
    /// Reads an image and extracts its features.
    ///
    /// # Arguments
    /// * `camera_file`: a `sensor.yaml` of the camera that took it, or a camera chain of Kalibr, whose `cam0` took it.
    ///
    /// # Errors
    /// An image, a camera, a mask or weights that cannot be read, an image of another size than the camera's.
    pub fn from_file(file: &Path, camera_file: &Path, arguments: &FeatureArguments) -> Result<Self> {
        let camera = read_camera(camera_file)?;
        let data = ImageData::from(file.to_path_buf());
        let image = read_image(&data, &camera, &format!("the camera of {}", camera_file.display()))?;
        let features = extract(&image, &data, arguments)?;
        Ok(Self { name: file.display().to_string(), camera, image: Some(image), features })
    }

    /// Reads an image of camera 0 of a recording: its `features.csv` where it has one, else the features of the image.
    ///
    /// # Arguments
    /// * `files`: calibration of Kalibr, in place of the recording's own.
    /// * `at_s`: seconds from the first frame; the nearest frame that can be used is taken.
    ///
    /// # Errors
    /// A recording that cannot be read, that is shorter than `at_s`, or that has neither features nor images; whatever
    /// [`QueryImage::from_file`] refuses.
    pub fn from_recording(
        recording: &Path,
        files: &CalibrationFiles,
        at_s: f64,
        arguments: &FeatureArguments,
    ) -> Result<Self> {
        let sequence = Sequence::open_without_readings(recording, files)?;
        let camera = sequence.cameras[0].camera.clone();
        let (frame, time_s) = nearest_frame(&sequence, at_s)?;
        let data = frame.images.get(&0);
        let of = format!("camera 0 of {}", recording.display());
        let image = data.map(|data| read_image(data, &camera, &of)).transpose()?;
        let features = match (frame.features.get(&0), &image, data) {
            (Some(features), _, _) => features.clone(),
            (None, Some(image), Some(data)) => extract(image, data, arguments)?,
            _ => bail!("{} has neither features nor images of camera 0", recording.display()),
        };
        Ok(Self { name: format!("{} at {time_s:.3} s", recording.display()), camera, image, features })
    }

    /// A localization request without a prior.
    pub fn request(&self) -> LocalizeRequest {
        LocalizeRequest {
            camera: self.camera.clone(),
            features: self.features.clone(),
            prior: None,
            gravity_in_camera: None,
        }
    }
}

/// An image of a recording that is localized by itself.
#[derive(Clone, Debug)]
pub struct RecordedQuery {
    /// Its time, ns.
    pub stamp_ns: i64,
    /// Pose of the camera that took it in the IMU's frame.
    pub imu_from_camera: Pose,
    /// The query, without a prior.
    pub request: LocalizeRequest,
}

/// Reads images of a recording, or their features where the recording has them, and extracts features. Of a rig its cameras are asked
/// in turn, of a stereo pair the first one.
///
/// # Arguments
/// * `within_s`: from when to when, seconds from the first frame.
/// * `period_s`: they are at least so far apart, seconds.
///
/// # Errors
/// A recording that cannot be read or has neither features nor images there; weights or a mask that cannot be read.
pub fn read_queries(
    recording: &Path,
    files: &CalibrationFiles,
    within_s: Range<f64>,
    period_s: f64,
    arguments: &FeatureArguments,
) -> Result<Vec<RecordedQuery>> {
    let sequence = Sequence::open_without_readings(recording, files)?;
    let mut turns = Turns::new(&sequence);
    let mut extractor = None;
    let masks = arguments.read_masks()?;
    let mut queries: Vec<RecordedQuery> = Vec::new();
    let first_ns = sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let is_within = |frame: &&Frame| within_s.contains(&((frame.stamp_ns - first_ns) as f64 * 1e-9));
    for frame in sequence.frames.iter().filter(is_within) {
        let is_due = |last: &RecordedQuery| (frame.stamp_ns - last.stamp_ns) as f64 >= period_s * 1e9;
        if !queries.last().is_none_or(is_due) {
            continue;
        }
        let Some(at) = turns.next(frame) else { continue };
        let sensor = &sequence.cameras[at];
        let features = match (frame.features.get(&at), frame.images.get(&at)) {
            (Some(features), _) => features.clone(),
            (None, Some(data)) => {
                let of = format!("camera {at} of {}", recording.display());
                let image = read_image(data, &sensor.camera, &of)?;
                let extractor = match &mut extractor {
                    Some(extractor) => extractor,
                    none => none.insert(arguments.open_for_queries()?),
                };
                let mask = masks.get(at).and_then(Option::as_ref);
                let seen = extractor.extract(&image, mask, arguments.max_features);
                feature_set(extractor.name(), seen.with_context(|| data.to_string())?)
            }
            (None, None) => continue,
        };
        let camera = sensor.camera.clone();
        let request = LocalizeRequest { camera, features, prior: None, gravity_in_camera: None };
        let imu_from_camera = sensor.imu_from_camera;
        queries.push(RecordedQuery { stamp_ns: frame.stamp_ns, imu_from_camera, request });
    }
    ensure!(!queries.is_empty(), "{} has neither features nor images there", recording.display());
    Ok(queries)
}

/// Which camera of a rig is asked next.
struct Turns {
    with_features: bool,
    /// The first camera of each group that sees the same, the one that has waited longest first.
    waiting: Vec<usize>,
}

impl Turns {
    fn new(sequence: &Sequence) -> Self {
        let waiting = camera_groups(&sequence.cameras).iter().map(|group| group.first).collect();
        Self { with_features: sequence.has_features(), waiting }
    }

    /// The one of those that a frame is of that has waited longest.
    fn next(&mut self, frame: &Frame) -> Option<usize> {
        let place = self.waiting.iter().position(|at| is_usable(frame, *at, self.with_features))?;
        let camera = self.waiting.remove(place);
        self.waiting.push(camera);
        Some(camera)
    }
}

/// Whether a frame can be localized by a camera.
///
/// # Arguments
/// * `with_features`: the recording has features; else images.
fn is_usable(frame: &Frame, camera: usize, with_features: bool) -> bool {
    if with_features { frame.features.contains_key(&camera) } else { frame.images.contains_key(&camera) }
}

/// Reads an image that must have the size of its camera's.
///
/// # Arguments
/// * `camera_of`: names the camera in the error.
///
/// # Errors
/// An image that cannot be read, another size.
pub fn read_image(data: &ImageData, camera: &Camera, camera_of: &str) -> Result<GrayImage> {
    let image = data.read()?.into_owned();
    if (image.width(), image.height()) != (camera.width as usize, camera.height as usize) {
        bail!(
            "{data} has {} x {} pixels, {camera_of} {} x {}: give the camera that took the image",
            image.width(),
            image.height(),
            camera.width,
            camera.height
        );
    }
    Ok(image)
}

fn extract(image: &GrayImage, data: &ImageData, arguments: &FeatureArguments) -> Result<FeatureSet> {
    let mut extractor = arguments.open_for_queries()?;
    let masks = arguments.read_masks()?;
    let mask = masks.first().and_then(Option::as_ref);
    let seen = extractor.extract(image, mask, arguments.max_features).with_context(|| data.to_string())?;
    Ok(feature_set(extractor.name(), seen))
}

/// The frame nearest to a time, and its own time in seconds from the first frame.
fn nearest_frame(sequence: &Sequence, at_s: f64) -> Result<(&Frame, f64)> {
    let root = sequence.root.display();
    let first_ns = sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let seconds = |frame: &Frame| (frame.stamp_ns - first_ns) as f64 * 1e-9;
    let end_s = sequence.frames.last().map_or(0.0, seconds);
    if !(0.0..=end_s).contains(&at_s) {
        bail!("--at {at_s}: {root} has frames from 0 to {end_s:.3} s");
    }
    let with_features = sequence.has_features();
    let distance = |frame: &&Frame| (seconds(frame) - at_s).abs();
    let usable = sequence.frames.iter().filter(|frame| is_usable(frame, 0, with_features));
    let nearest = usable.min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let frame = nearest.with_context(|| format!("{root} has neither features nor images of camera 0"))?;
    Ok((frame, seconds(frame)))
}
