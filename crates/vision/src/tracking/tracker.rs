//! The tracker: images in, tracks out.
//!
//! Each image: points of the image before are predicted by the rotation, found, checked backward, checked against one
//! rigid motion; gaps in the grid are filled with new corners; and all are looked for in the second camera.

use super::frame::{TrackedPixel, TrackerError, TrackerFrame, TrackerReport};
use super::lucas_kanade::{Found, Warp, align_mutually};
use super::options::TrackerOptions;
use super::outliers::{OutlierOptions, find_outliers};
use super::prediction::{Sight, predict_turned};
use super::relative_pose::{BearingPair, RelativePose};
use super::stereo::StereoPair;
use crate::corners::{Spacing, detect_corners};
use crate::image::GrayImage;
use crate::pyramid::Pyramid;
use geometry::{Camera, Pose, Rotation};
use nalgebra::Vector2;

/// Two tracks that come closer than this share of the distance of corners see the same thing: the younger one ends.
const MERGE_SHARE: f32 = 0.5;
/// How often lost points are sought once more from where their found neighbours went. On `mh_01_handheld_16s` this
/// doubles the median length of a track.
const RETRIES: usize = 3;
/// Inverse depths that a point without neighbours is sought at in the second camera, 1/m.
const FIRST_INVERSE_DEPTHS: [f64; 3] = [0.2, 0.0, 0.8];

/// Follows points through the images of a camera or a stereo pair.
///
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
///     let frame = TrackerFrame { stamp_ns, image: image.clone(), second_image: None, rotation: None, rotation_sigma: 0.0 };
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
    last: Option<Last>,
    next_id: u64,
    report: TrackerReport,
}

/// The image before.
#[derive(Debug)]
struct Last {
    stamp_ns: i64,
    pyramid: Pyramid,
    tracks: Vec<Track>,
}

#[derive(Clone, Copy, Debug)]
struct Track {
    id: u64,
    sight: Sight,
    /// From the second camera, 1/m.
    inverse_depth: Option<f64>,
}

impl Track {
    fn pixel(&self) -> Vector2<f32> {
        self.sight.pixel.cast()
    }
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    ///
    /// # Arguments
    /// * `camera`: the first camera.
    /// * `second`: the second camera and the pose of the first one in its frame (metres), if there is one.
    ///
    /// # Errors
    /// [`TrackerError::MaskSize`].
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
        Ok(Self { camera, pair, options, last: None, next_id: 0, report })
    }

    /// What happened at the last image.
    pub fn report(&self) -> &TrackerReport {
        &self.report
    }

    /// Time of the last image, nanoseconds.
    pub fn last_stamp_ns(&self) -> Option<i64> {
        self.last.as_ref().map(|last| last.stamp_ns)
    }

    /// Takes the next image.
    ///
    /// # Returns
    /// All points in sight, those of the first camera first.
    ///
    /// # Errors
    /// [`TrackerError`]; the tracker then is as before.
    pub fn track(&mut self, frame: TrackerFrame) -> Result<Vec<TrackedPixel>, TrackerError> {
        self.check(&frame)?;
        let levels = self.options.alignment.levels;
        let pyramid = Pyramid::new(self.options.equalization.apply(frame.image), levels);
        self.report = TrackerReport::default();
        let last = self.last.take();
        let connected = last.filter(|last| frame.stamp_ns - last.stamp_ns <= self.options.max_gap_ns);
        let mut tracks = match &connected {
            Some(last) => self.follow(last, &pyramid, frame.rotation.as_ref(), frame.rotation_sigma),
            None => Vec::new(),
        };
        self.report.continued = tracks.len();
        self.begin(&pyramid, &mut tracks);
        let mut seen: Vec<TrackedPixel> = tracks
            .iter()
            .map(|track| TrackedPixel { camera: 0, feature_id: track.id, pixel: track.sight.pixel })
            .collect();
        if let (Some(image), Some(pair)) = (frame.second_image, &self.pair) {
            let second = Pyramid::new(self.options.equalization.apply(image), levels);
            seen.extend(look_beside(pair, &self.options, &pyramid, &second, &mut tracks));
            self.report.stereo = seen.len() - tracks.len();
        }
        self.last = Some(Last { stamp_ns: frame.stamp_ns, pyramid, tracks });
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

    /// Finds the points of the last image in this one.
    fn follow(
        &mut self,
        last: &Last,
        pyramid: &Pyramid,
        rotation: Option<&Rotation>,
        rotation_sigma: f64,
    ) -> Vec<Track> {
        let found = self.find_all(last, pyramid, rotation);
        let mut spacing = Spacing::new(pyramid.base(), self.options.corners.min_distance * MERGE_SHARE);
        let mut tracks = Vec::with_capacity(last.tracks.len());
        let mut pairs = Vec::with_capacity(last.tracks.len());
        // Older tracks come first.
        for (track, found) in last.tracks.iter().zip(found) {
            let Some(found) = found else { continue };
            let centre = found.warp.centre;
            if !is_open(self.options.masks[0].as_ref(), centre) || !spacing.is_free(centre) {
                continue;
            }
            let Some(sight) = Sight::new(&self.camera, centre.cast()) else { continue };
            spacing.insert(centre);
            pairs.push(BearingPair { previous: track.sight.bearing(), current: sight.bearing() });
            tracks.push(Track { sight, ..*track });
        }
        self.report.lost = last.tracks.len() - tracks.len();
        let options =
            OutlierOptions { seed: self.options.outliers.seed ^ self.next_id, ..self.options.outliers };
        let known = rotation.map(|rotation| (rotation, rotation_sigma));
        if let Some(consensus) = find_outliers(&pairs, known, &options) {
            let mut inlier = consensus.inliers.iter();
            tracks.retain(|_| inlier.next().copied().unwrap_or(false));
            self.report.outliers = pairs.len() - tracks.len();
            self.report.parallax = median_parallax(&pairs, &consensus.pose);
            self.report.motion = Some(consensus.pose);
        }
        tracks
    }

    /// For each point of the last image where it is now, if it was found.
    fn find_all(&self, last: &Last, pyramid: &Pyramid, rotation: Option<&Rotation>) -> Vec<Option<Found>> {
        let find = |track: &Track, guess: &Warp| {
            align_mutually(&last.pyramid, pyramid, track.pixel(), guess, &self.options.alignment).ok()
        };
        let mut found: Vec<Option<Found>> = last
            .tracks
            .iter()
            .map(|track| {
                let guess = match rotation {
                    Some(rotation) => predict_turned(&self.camera, rotation, &track.sight)?,
                    None => Warp::moved_to(track.pixel()),
                };
                find(track, &guess)
            })
            .collect();
        // Large motion that nothing predicted, parallax or turning: what was found shows where its neighbours went.
        for _ in 0..RETRIES {
            let guesses: Vec<(usize, Warp)> = (0..found.len())
                .filter(|index| found[*index].is_none())
                .filter_map(|index| Some((index, carried_along(&last.tracks, &found, index)?)))
                .collect();
            let mut any = false;
            for (index, guess) in guesses {
                found[index] = find(&last.tracks[index], &guess);
                any |= found[index].is_some();
            }
            if !any {
                break;
            }
        }
        found
    }

    /// Fills the grid with new corners.
    fn begin(&mut self, pyramid: &Pyramid, tracks: &mut Vec<Track>) {
        let existing: Vec<Vector2<f32>> = tracks.iter().map(Track::pixel).collect();
        let mask = self.options.masks[0].as_ref();
        let corners =
            detect_corners(pyramid.base(), &existing, mask, self.options.points, &self.options.corners);
        for corner in corners {
            let Some(sight) = Sight::new(&self.camera, corner.pixel.cast()) else { continue };
            tracks.push(Track { id: self.next_id, sight, inverse_depth: None });
            self.next_id += 1;
            self.report.begun += 1;
        }
    }
}

/// Finds the tracks in the second camera and remembers how far they are.
fn look_beside(
    pair: &StereoPair,
    options: &TrackerOptions,
    first: &Pyramid,
    second: &Pyramid,
    tracks: &mut [Track],
) -> Vec<TrackedPixel> {
    let mut seen = Vec::with_capacity(tracks.len());
    let mut known: Vec<f64> = tracks.iter().filter_map(|track| track.inverse_depth).collect();
    for track in tracks {
        let usual = median(&mut known);
        let own = track.inverse_depth.or(usual).into_iter();
        let guesses: Vec<f64> = own.chain(FIRST_INVERSE_DEPTHS).collect();
        let at_most = if track.inverse_depth.is_some() { 1 } else { guesses.len() };
        let found = pair.find(first, second, track.sight.pixel, &guesses[..at_most], &options.stereo);
        let found = found.filter(|found| is_open(options.masks[1].as_ref(), found.pixel.cast()));
        track.inverse_depth = found.map(|found| found.inverse_depth);
        if let Some(found) = found {
            if guesses.len() > 1 {
                known.push(found.inverse_depth);
            }
            seen.push(TrackedPixel { camera: 1, feature_id: track.id, pixel: found.pixel });
        }
    }
    seen
}

/// Where a lost point should be if it moved like its nearest found neighbour.
fn carried_along(tracks: &[Track], found: &[Option<Found>], index: usize) -> Option<Warp> {
    let own = tracks[index].pixel();
    let near = tracks.iter().zip(found).filter_map(|(track, found)| {
        let offset = own - track.pixel();
        found.as_ref().map(|found| (offset, found.warp))
    });
    let (offset, warp) = near.min_by(|a, b| a.0.norm_squared().total_cmp(&b.0.norm_squared()))?;
    Some(Warp { centre: warp.centre + warp.linear * offset, linear: warp.linear })
}

/// Whether a mask lets a point pass.
fn is_open(mask: Option<&GrayImage>, point: Vector2<f32>) -> bool {
    mask.is_none_or(|mask| {
        let index = |value: f32, side: usize| (value.round().max(0.0) as usize).min(side - 1);
        mask.get(index(point.x, mask.width()), index(point.y, mask.height())) != 0
    })
}

fn median_parallax(pairs: &[BearingPair], motion: &RelativePose) -> Option<f64> {
    let turned = |pair: &BearingPair| (motion.current_from_previous * pair.previous - pair.current).norm();
    median(&mut pairs.iter().map(turned).collect::<Vec<_>>())
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn size_of(image: &GrayImage) -> [usize; 2] {
    [image.width(), image.height()]
}

fn size_by(camera: &Camera) -> [usize; 2] {
    [camera.width as usize, camera.height as usize]
}
