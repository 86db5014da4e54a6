//! The tracker: images in, tracks out.
//!
//! For each image: the points of the previous image are predicted by the rotation, aligned with the previous image and then
//! with the patch of their first image, with a forward-backward check,
//! and checked against one relative pose; grid cells below their quota are filled with new corners; all points are
//! matched in the second camera.

use super::first_patch::{FirstPatch, Followed};
use super::frames::{TrackedPixel, TrackerError, TrackerFrame, TrackerReport};
use super::lucas_kanade::{Aligner, AlignmentOptions, Warp};
use super::options::TrackerOptions;
use super::outliers::{OutlierOptions, find_outliers};
use super::prediction::{Ray, predict_rotated};
use super::relative_pose::{BearingPair, RelativePose};
use super::stereo::{StereoOptions, StereoPair};
use crate::detection::detect_corners;
use crate::detection::spacing::Spacing;
use crate::image::GrayImage;
use crate::image::Pyramid;
use geometry::{Camera, Pose, Rotation, median};
use nalgebra::Vector2;

/// Two tracks closer than this fraction of the corner distance show the same point: the younger one ends.
const MERGE_DISTANCE_RATIO: f32 = 0.5;
/// Where fewer than this part of the points are found, corners that just stand out of the noise are taken, too.
const FEW_POINTS: f32 = 0.75;
/// How often lost points are aligned again, predicted by the motion of a tracked neighbour. On `mh_01_handheld_16s`
/// this doubles the median track length.
const RETRIES: usize = 3;
/// Initial inverse depths of stereo matching for points without a known one, 1/m.
const INITIAL_INVERSE_DEPTHS: [f64; 3] = [0.2, 0.0, 0.8];
/// Pyramid levels of stereo matching where the depth is known from the image before: it moves the point by less than a pixel
/// until the next.
const KNOWN_DEPTH_LEVELS: usize = 1;

/// Tracks points through the images of a camera or a stereo pair.
///
/// # Coordinate systems
/// Pixels are distorted; (0, 0) is the centre of the top-left pixel. Camera frames: x right, y down, z forward.
///
/// # Example
/// ```
/// use geometry::{Camera, Distortion};
/// use vision::GrayImage;
/// use vision::tracking::{Tracker, TrackerFrame, TrackerOptions};
///
/// let camera = Camera {
///     width: 160, height: 120, focal: [100.0; 2], centre: [79.5, 59.5], distortion: Distortion::None,
/// };
/// let mut tracker = Tracker::new(camera, None, TrackerOptions::default())?;
/// let image = GrayImage::from_fn(160, 120, |x, y| if (x / 16 + y / 16) % 2 == 0 { 40 } else { 200 });
/// for stamp_ns in [0, 50_000_000] {
///     let frame = TrackerFrame { stamp_ns, image: image.clone(), second_image: None, rotation: None, sigma_rotation_rad: 0.0 };
///     let tracks = tracker.track(frame)?;
///     assert!(tracks.len() > 20);
/// }
/// # Ok::<(), vision::tracking::TrackerError>(())
/// ```
#[derive(Debug)]
pub struct Tracker {
    camera: Camera,
    pair: Option<StereoPair>,
    options: TrackerOptions,
    previous: Option<PreviousImage>,
    next_id: u64,
    report: TrackerReport,
}

/// Pyramid and tracks of the previous image.
#[derive(Debug)]
struct PreviousImage {
    stamp_ns: i64,
    pyramid: Pyramid,
    tracks: Vec<Track>,
}

#[derive(Clone, Debug)]
struct Track {
    id: u64,
    ray: Ray,
    /// `None` where the first image has no structure there: such a track ends with it.
    patch: Option<FirstPatch>,
    /// From stereo matching, 1/m.
    inverse_depth: Option<f64>,
    /// Images since the last one without a stereo match in spite of all guesses.
    unmatched: usize,
}

impl Track {
    fn pixel(&self) -> Vector2<f32> {
        self.ray.pixel.cast()
    }
}

impl Tracker {
    /// Creates a tracker without tracks.
    ///
    /// # Arguments
    /// * `camera`: the first camera.
    /// * `second`: the second camera and `second_from_first`, the pose of the first camera in its frame (metres).
    ///
    /// # Errors
    /// [`TrackerError::MaskSize`] if a mask does not have the size of its camera.
    pub fn new(
        camera: Camera,
        second: Option<(Camera, Pose)>,
        options: TrackerOptions,
    ) -> Result<Self, TrackerError> {
        let cameras = [Some(&camera), second.as_ref().map(|(camera, _)| camera)];
        for (index, (mask, camera)) in options.masks.iter().zip(cameras).enumerate() {
            let (Some(mask), Some(camera)) = (mask, camera) else { continue };
            let [have, want] = [size_of(mask), size_by(camera)];
            if have != want {
                return Err(TrackerError::MaskSize { camera: index as u8, have, want });
            }
        }
        let pair = second.map(|(second, second_from_first)| StereoPair {
            first: camera.clone(),
            second,
            second_from_first,
        });
        let report = TrackerReport::default();
        Ok(Self { camera, pair, options, previous: None, next_id: 0, report })
    }

    /// Statistics of the last image.
    pub fn report(&self) -> &TrackerReport {
        &self.report
    }

    /// Timestamp of the last image, nanoseconds.
    pub fn last_stamp_ns(&self) -> Option<i64> {
        self.previous.as_ref().map(|previous| previous.stamp_ns)
    }

    /// Processes the next image.
    ///
    /// # Returns
    /// All tracked points, those of the first camera first.
    ///
    /// # Errors
    /// [`TrackerError`]; the tracker is then unchanged.
    pub fn track(&mut self, frame: TrackerFrame) -> Result<Vec<TrackedPixel>, TrackerError> {
        self.check(&frame)?;
        let levels = self.options.alignment.levels;
        let pyramid = Pyramid::new(self.options.equalization.apply(frame.image), levels);
        self.report = TrackerReport::default();
        let previous = self.previous.take();
        let connected =
            previous.filter(|previous| frame.stamp_ns - previous.stamp_ns <= self.options.max_gap_ns);
        let mut tracks = match connected {
            Some(previous) => {
                self.track_points(previous, &pyramid, frame.rotation.as_ref(), frame.sigma_rotation_rad)
            }
            None => Vec::new(),
        };
        self.report.continued = tracks.len();
        self.add_corners(&pyramid, &mut tracks);
        let mut seen: Vec<TrackedPixel> = tracks
            .iter()
            .map(|track| TrackedPixel { camera: 0, feature_id: track.id, pixel: track.ray.pixel })
            .collect();
        if let (Some(image), Some(pair)) = (frame.second_image, &self.pair) {
            let second = Pyramid::new(self.options.equalization.apply(image), levels);
            seen.extend(match_stereo(pair, &self.options, &pyramid, &second, &mut tracks));
            self.report.stereo = seen.len() - tracks.len();
        }
        self.previous = Some(PreviousImage { stamp_ns: frame.stamp_ns, pyramid, tracks });
        Ok(seen)
    }

    fn check(&self, frame: &TrackerFrame) -> Result<(), TrackerError> {
        let cameras = [Some(&self.camera), self.pair.as_ref().map(|pair| &pair.second)];
        let images = [Some(&frame.image), frame.second_image.as_ref()];
        for (index, (image, camera)) in images.into_iter().zip(cameras).enumerate() {
            let (Some(image), Some(camera)) = (image, camera) else { continue };
            let [have, want] = [size_of(image), size_by(camera)];
            if have != want {
                return Err(TrackerError::ImageSize { camera: index as u8, have, want });
            }
        }
        match self.last_stamp_ns() {
            Some(last_ns) if frame.stamp_ns <= last_ns => {
                Err(TrackerError::OldImage { stamp_ns: frame.stamp_ns, last_ns })
            }
            _ => Ok(()),
        }
    }

    /// Tracks the points of the previous image into this one.
    fn track_points(
        &mut self,
        previous: PreviousImage,
        pyramid: &Pyramid,
        rotation: Option<&Rotation>,
        sigma_rotation_rad: f64,
    ) -> Vec<Track> {
        let found = self.align_all(&previous, pyramid, rotation);
        let before = previous.tracks.len();
        let mut spacing =
            Spacing::new(pyramid.base(), self.options.corners.min_distance * MERGE_DISTANCE_RATIO);
        let mut tracks = Vec::with_capacity(before);
        let mut pairs = Vec::with_capacity(before);
        // Older tracks have priority.
        for (mut track, found) in previous.tracks.into_iter().zip(found) {
            let Some(found) = found else { continue };
            let centre = found.warp.centre;
            if !is_unmasked(self.options.mask_of(0), centre) || !spacing.is_free(centre) {
                continue;
            }
            let Some(ray) = Ray::new(&self.camera, centre.cast()) else { continue };
            spacing.insert(centre);
            pairs.push(BearingPair { previous: track.ray.bearing(), current: ray.bearing() });
            if let Some(patch) = &mut track.patch {
                patch.linear = found.from_first;
            }
            tracks.push(Track { ray, ..track });
        }
        self.report.lost = before - tracks.len();
        let options =
            OutlierOptions { seed: self.options.outliers.seed ^ self.next_id, ..self.options.outliers };
        let known = rotation.map(|rotation| (rotation, sigma_rotation_rad));
        if let Some(consensus) = find_outliers(&pairs, known, &options) {
            let mut inlier = consensus.inliers.iter();
            tracks.retain(|_| inlier.next().copied().unwrap_or(false));
            self.report.outliers = pairs.len() - tracks.len();
            self.report.parallax = median_parallax(&pairs, &consensus.pose);
            self.report.motion = Some(consensus.pose);
        }
        tracks
    }

    /// Alignment of each point of the previous image, `None` where it failed.
    fn align_all(
        &self,
        previous: &PreviousImage,
        pyramid: &Pyramid,
        rotation: Option<&Rotation>,
    ) -> Vec<Option<Followed>> {
        let mut aligner = Aligner::new();
        let images = [&previous.pyramid, pyramid];
        let mut find = |track: &Track, guess: &Warp| {
            let options = &self.options.alignment;
            aligner.follow(images, track.pixel(), guess, track.patch.as_ref()?, options).ok()
        };
        let mut found: Vec<Option<Followed>> = previous
            .tracks
            .iter()
            .map(|track| {
                let guess = match rotation {
                    Some(rotation) => predict_rotated(&self.camera, rotation, &track.ray)?,
                    None => Warp::moved_to(track.pixel()),
                };
                find(track, &guess)
            })
            .collect();
        // Large unpredicted motion: predict lost points by the motion of tracked neighbours.
        for _ in 0..RETRIES {
            let guesses: Vec<(usize, Warp)> = (0..found.len())
                .filter(|index| found[*index].is_none())
                .filter_map(|index| {
                    Some((index, extrapolate_from_neighbour(&previous.tracks, &found, index)?))
                })
                .collect();
            let mut any = false;
            for (index, guess) in guesses {
                found[index] = find(&previous.tracks[index], &guess);
                any |= found[index].is_some();
            }
            if !any {
                break;
            }
        }
        found
    }

    /// Fills grid cells below their quota with new corners.
    fn add_corners(&mut self, pyramid: &Pyramid, tracks: &mut Vec<Track>) {
        let mut points: Vec<Vector2<f32>> = tracks.iter().map(Track::pixel).collect();
        let TrackerOptions { points: wanted, corners: options, .. } = self.options;
        let (image, mask) = (pyramid.base(), self.options.mask_of(0));
        let mut corners = detect_corners(image, &points, mask, wanted, &options);
        points.extend(corners.iter().map(|corner| corner.pixel));
        if (points.len() as f32) < FEW_POINTS * wanted as f32 {
            corners.extend(detect_corners(image, &points, mask, wanted, &options.for_little_light(image)));
        }
        let mut aligner = Aligner::new();
        for corner in corners {
            let Some(ray) = Ray::new(&self.camera, corner.pixel.cast()) else { continue };
            let patch = aligner.first_patch(pyramid, corner.pixel, &self.options.alignment);
            if patch.is_none() && corner.score < options.min_score {
                continue;
            }
            tracks.push(Track { id: self.next_id, ray, patch, inverse_depth: None, unmatched: 0 });
            self.next_id += 1;
            self.report.started += 1;
        }
    }
}

/// Matches the tracks in the second camera and stores their inverse depths.
fn match_stereo(
    pair: &StereoPair,
    options: &TrackerOptions,
    first: &Pyramid,
    second: &Pyramid,
    tracks: &mut [Track],
) -> Vec<TrackedPixel> {
    let mut aligner = Aligner::new();
    let mut seen = Vec::with_capacity(tracks.len());
    let mut known: Vec<f64> = tracks.iter().filter_map(|track| track.inverse_depth).collect();
    for track in tracks {
        let mut find = |guesses: &[f64], levels: usize| {
            let alignment = AlignmentOptions { levels, ..options.stereo.alignment };
            let options = StereoOptions { alignment, ..options.stereo };
            pair.find_by(&mut aligner, [first, second], track.ray.pixel, guesses, &options)
        };
        let found = if let Some(own) = track.inverse_depth {
            find(&[own], KNOWN_DEPTH_LEVELS)
        } else {
            let guesses: Vec<f64> = median(&mut known).into_iter().chain(INITIAL_INVERSE_DEPTHS).collect();
            let in_turn = track.unmatched.checked_sub(1).map(|images| images % guesses.len());
            let guesses = in_turn.map_or(&guesses[..], |index| &guesses[index..=index]);
            find(guesses, options.stereo.alignment.levels)
        };
        let found = found.filter(|found| is_unmasked(options.mask_of(1), found.pixel.cast()));
        track.unmatched =
            if found.is_some() || track.inverse_depth.is_some() { 0 } else { track.unmatched + 1 };
        track.inverse_depth = found.map(|found| found.inverse_depth);
        if let Some(found) = found {
            known.push(found.inverse_depth);
            seen.push(TrackedPixel { camera: 1, feature_id: track.id, pixel: found.pixel });
        }
    }
    seen
}

/// Predicts a lost point by the warp of its nearest tracked neighbour.
fn extrapolate_from_neighbour(tracks: &[Track], found: &[Option<Followed>], index: usize) -> Option<Warp> {
    let own = tracks[index].pixel();
    let tracked = tracks.iter().zip(found).filter_map(|(track, found)| {
        let offset = own - track.pixel();
        found.as_ref().map(|found| (offset, found.warp))
    });
    let (offset, warp) = tracked.min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))?;
    Some(Warp { centre: warp.centre + warp.linear * offset, linear: warp.linear })
}

/// Whether the mask is non-zero at a point.
fn is_unmasked(mask: Option<&GrayImage>, point: Vector2<f32>) -> bool {
    mask.is_none_or(|mask| {
        let index = |value: f32, side: usize| (value.round().max(0.0) as usize).min(side - 1);
        mask.get(index(point.x, mask.width()), index(point.y, mask.height())) != 0
    })
}

fn median_parallax(pairs: &[BearingPair], motion: &RelativePose) -> Option<f64> {
    let angle = |pair: &BearingPair| (motion.current_from_previous * pair.previous - pair.current).norm();
    median(&mut pairs.iter().map(angle).collect::<Vec<_>>())
}

fn size_of(image: &GrayImage) -> [usize; 2] {
    [image.width(), image.height()]
}

fn size_by(camera: &Camera) -> [usize; 2] {
    [camera.width as usize, camera.height as usize]
}
