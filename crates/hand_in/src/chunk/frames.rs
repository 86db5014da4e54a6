//! Images: their tracked points, as differences from image to image, and the features of keyframe candidates.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector2;
use types::features::MAX_FEATURES;
use types::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet, TrackObservation};

use super::{SessionFrame, Times};
use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// Steps a pixel of tracked points.
pub(crate) const TRACK_STEPS: f64 = 16.0;
/// Steps a pixel of features.
pub(crate) const FEATURE_STEPS: f64 = 8.0;
/// Largest pixel of either sign: a camera has at most 65,536 columns.
const MOST_PIXEL: f64 = 1e6;
/// Most bytes of the name of an extractor.
const MAX_NAME_BYTES: usize = 256;
/// Kinds of descriptors by their number in a file.
const KINDS: [DescriptorKind; 3] = [DescriptorKind::Binary, DescriptorKind::Float, DescriptorKind::Int8];
/// Cameras of a point that fit into the bits of an integer.
const MAX_CAMERAS: u8 = 64;
/// Most points of all cameras in the images of a chunk; a robot records some thousands.
const MAX_POINTS: usize = 1 << 18;

/// Pixels of a point in steps, by camera.
type InCameras = BTreeMap<u8, [i64; 2]>;

/// Features of a chunk: of one extractor, with descriptors of one format.
struct Extractor {
    name: String,
    format: DescriptorFormat,
}

impl Extractor {
    /// That of the first features.
    fn of(frames: &[SessionFrame]) -> Option<Self> {
        let features = frames.iter().find_map(|frame| frame.features.as_ref())?;
        Some(Self { name: features.extractor.clone(), format: features.descriptors.format() })
    }

    fn made(&self, features: &FeatureSet) -> bool {
        features.extractor == self.name && features.descriptors.format() == self.format
    }

    fn write(extractor: Option<&Self>, out: &mut Writer) {
        let Some(Self { name, format }) = extractor else { return out.unsigned(0) };
        let kind = KINDS.iter().position(|kind| *kind == format.kind).unwrap_or_default();
        out.unsigned(kind as u64 + 1);
        out.unsigned(u64::from(format.width));
        out.unsigned(name.len() as u64);
        out.bytes(name.as_bytes());
    }

    fn read(input: &mut Reader<'_>) -> Result<Option<Self>, ChunkError> {
        let Some(kind) = input.unsigned()?.checked_sub(1) else { return Ok(None) };
        let kind = usize::try_from(kind).ok().and_then(|kind| KINDS.get(kind));
        let kind = *kind.ok_or(ChunkError::Range("the kind of descriptors"))?;
        let width = u16::try_from(input.unsigned()?).ok().filter(|width| *width > 0);
        let width = width.ok_or(ChunkError::Range("the width of descriptors"))?;
        let length = input.count()?;
        let name = std::str::from_utf8(input.bytes(length)?).ok();
        let name = name.filter(|name| name.len() <= MAX_NAME_BYTES && !name.chars().any(char::is_control));
        let name = name.ok_or(ChunkError::Range("the name of the extractor"))?.to_owned();
        Ok(Some(Self { name, format: DescriptorFormat { kind, width } }))
    }
}

/// Features of another extractor or format than the first ones of a chunk are left out.
pub(super) fn write(out: &mut Writer, frames: &[SessionFrame]) {
    let extractor = Extractor::of(frames);
    Extractor::write(extractor.as_ref(), out);
    out.unsigned(frames.len() as u64);
    let (mut times, mut last) = (Times(None), HashMap::new());
    for frame in frames {
        times.write(out, frame.stamp_ns);
        write_tracks(out, &frame.tracks, &mut last);
        let of_extractor =
            |features: &&FeatureSet| extractor.as_ref().is_some_and(|extractor| extractor.made(features));
        let features = frame.features.as_ref().filter(of_extractor);
        out.unsigned(features.map_or(0, |features| features.len() as u64 + 1));
        if let Some(features) = features {
            let steps =
                |value: f32| (f64::from(value).clamp(-MOST_PIXEL, MOST_PIXEL) * FEATURE_STEPS).round();
            features.pixels.as_flattened().iter().for_each(|value| out.signed(steps(*value) as i64));
            out.bytes(&features.descriptors.bytes);
        }
    }
}

fn write_tracks(out: &mut Writer, tracks: &[TrackObservation], last: &mut HashMap<(u64, u8), [i64; 2]>) {
    let mut points: BTreeMap<u64, InCameras> = BTreeMap::new();
    for track in tracks {
        let fits = track.pixel.iter().all(|value| value.abs() <= MOST_PIXEL);
        if fits && track.camera < MAX_CAMERAS {
            let pixel = track.pixel.map(|value| (value * TRACK_STEPS).round() as i64);
            points.entry(track.feature_id).or_default().insert(track.camera, [pixel.x, pixel.y]);
        }
    }
    out.unsigned(points.len() as u64);
    let mut last_id = 0;
    for (&id, cameras) in &points {
        out.unsigned(id.wrapping_sub(last_id));
        last_id = id;
        out.unsigned(cameras.keys().fold(0, |bits, camera| bits | 1 << camera));
        let mut beside = [0; 2];
        for (&camera, &pixel) in cameras {
            let near = last.insert((id, camera), pixel).unwrap_or(beside);
            (0..2).for_each(|axis| out.signed(pixel[axis] - near[axis]));
            beside = pixel;
        }
    }
}

pub(super) fn read(input: &mut Reader<'_>, cameras: usize) -> Result<Vec<SessionFrame>, ChunkError> {
    let extractor = Extractor::read(input)?;
    let (mut frames, count) = input.list()?;
    let (mut times, mut last) = (Times(None), HashMap::new());
    for _ in 0..count {
        let stamp_ns = times.read(input)?;
        let tracks = read_tracks(input, cameras, &mut last)?;
        frames.push(SessionFrame { stamp_ns, tracks, features: read_features(input, extractor.as_ref())? });
    }
    Ok(frames)
}

fn read_tracks(
    input: &mut Reader<'_>,
    cameras: usize,
    last: &mut HashMap<(u64, u8), [i64; 2]>,
) -> Result<Vec<TrackObservation>, ChunkError> {
    let (mut tracks, mut id) = (Vec::new(), 0_u64);
    for point in 0..input.count()? {
        let step = input.unsigned()?;
        if point > 0 && step == 0 {
            return Err(ChunkError::Range("the id of a point"));
        }
        id = id.checked_add(step).ok_or(ChunkError::Range("the id of a point"))?;
        let bits = input.unsigned()?;
        let mut beside = [0; 2];
        for camera in (0..MAX_CAMERAS).filter(|camera| bits >> camera & 1 == 1) {
            if usize::from(camera) >= cameras {
                return Err(ChunkError::Range("the camera of a point"));
            }
            let mut pixel = last.get(&(id, camera)).copied().unwrap_or(beside);
            for value in &mut pixel {
                *value = stepped(*value, input.signed()?, TRACK_STEPS)?;
            }
            last.insert((id, camera), pixel);
            if last.len() > MAX_POINTS {
                return Err(ChunkError::Range("the number of points"));
            }
            beside = pixel;
            let pixel = Vector2::from(pixel).map(|value| value as f64 / TRACK_STEPS);
            input.take::<TrackObservation>(1)?;
            tracks.push(TrackObservation { camera, feature_id: id, pixel });
        }
    }
    tracks.shrink_to_fit();
    Ok(tracks)
}

/// A pixel in steps that another one and a difference give.
fn stepped(value: i64, step: i64, steps: f64) -> Result<i64, ChunkError> {
    let next = value.checked_add(step).ok_or(ChunkError::Range("a pixel"))?;
    if next.unsigned_abs() as f64 > MOST_PIXEL * steps { Err(ChunkError::Range("a pixel")) } else { Ok(next) }
}

fn read_features(
    input: &mut Reader<'_>,
    extractor: Option<&Extractor>,
) -> Result<Option<FeatureSet>, ChunkError> {
    let Some(count) = input.unsigned()?.checked_sub(1) else { return Ok(None) };
    let Extractor { name, format } = extractor.ok_or(ChunkError::Range("the number of features"))?;
    let count = usize::try_from(count)
        .ok()
        .filter(|count| *count <= MAX_FEATURES)
        .ok_or(ChunkError::Range("the number of features"))?;
    input.take::<u8>(name.len())?;
    input.take::<[f32; 2]>(count)?;
    let mut pixels = Vec::with_capacity(count);
    for _ in 0..count {
        let mut pixel = [0.0; 2];
        for value in &mut pixel {
            *value = (stepped(0, input.signed()?, FEATURE_STEPS)? as f64 / FEATURE_STEPS) as f32;
        }
        pixels.push(pixel);
    }
    let bytes = input.bytes(count * usize::from(format.width))?;
    input.take::<u8>(bytes.len())?;
    let bytes = bytes.to_vec();
    let descriptors = Descriptors { bytes, ..Descriptors::empty(*format) };
    Ok(Some(FeatureSet { pixels, descriptors, extractor: name.clone() }))
}
