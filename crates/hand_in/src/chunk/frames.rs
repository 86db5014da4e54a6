//! Images: their tracked points, as differences from image to image, and keyframe candidates.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector2;
use types::TrackObservation;

use super::candidates::{self, Extractor};
use super::pixels::{MOST_PIXEL, stepped};
use super::{ChunkFormat, SessionFrame, Times};
use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;

/// Steps a pixel of tracked points.
pub(crate) const TRACK_STEPS: f64 = 16.0;
/// Cameras of a point that fit into the bits of an integer.
const MAX_CAMERAS: u8 = 64;
/// Most points of all cameras in the images of a chunk; a robot records some thousands.
const MAX_POINTS: usize = 1 << 18;

/// Pixels of a point in steps, by camera.
type InCameras = BTreeMap<u8, [i64; 2]>;

pub(super) fn write(out: &mut Writer, frames: &[SessionFrame], format: ChunkFormat) {
    let extractor = Extractor::of(frames, format);
    Extractor::write(extractor.as_ref(), out);
    out.unsigned(frames.len() as u64);
    let (mut times, mut last) = (Times(None), HashMap::new());
    for frame in frames {
        times.write(out, frame.stamp_ns);
        write_tracks(out, &frame.tracks, &mut last);
        candidates::write(out, &frame.candidates, extractor.as_ref(), format);
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

pub(super) fn read(input: &mut Reader<'_>, format: ChunkFormat) -> Result<Vec<SessionFrame>, ChunkError> {
    let extractor = Extractor::read(input)?;
    let (mut frames, count) = input.list()?;
    let (mut times, mut last) = (Times(None), HashMap::new());
    for _ in 0..count {
        let stamp_ns = times.read(input)?;
        let tracks = read_tracks(input, format.cameras, &mut last)?;
        let candidates = candidates::read(input, extractor.as_ref(), format)?;
        frames.push(SessionFrame { stamp_ns, tracks, candidates });
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
