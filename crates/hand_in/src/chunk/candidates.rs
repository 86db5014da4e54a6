//! Keyframe candidates: images of which features are recorded.

use types::features::MAX_FEATURES;
use types::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet};

use super::pixels::{MOST_PIXEL, stepped};
use super::{ChunkFormat, SessionFrame};
use crate::bytes::{Reader, Writer};
use crate::error::ChunkError;
use crate::schema::Schema;

/// Steps a pixel of features.
const FEATURE_STEPS: f64 = 8.0;
/// Most bytes of the name of an extractor.
const MAX_NAME_BYTES: usize = 256;
/// Kinds of descriptors by their number in a file.
const KINDS: [DescriptorKind; 3] = [DescriptorKind::Binary, DescriptorKind::Float, DescriptorKind::Int8];

/// The image of one camera that is a keyframe candidate.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The camera: one that the map is asked about, the first one of a stereo pair or a single one.
    pub camera: usize,
    /// The features of its image; pixels to an eighth.
    pub features: FeatureSet,
}

/// Features of a chunk: of one extractor, with descriptors of one format.
pub(super) struct Extractor {
    name: String,
    format: DescriptorFormat,
}

impl Extractor {
    /// That of the first candidate that is written.
    pub(super) fn of(frames: &[SessionFrame], format: ChunkFormat) -> Option<Self> {
        let mut candidates = frames.iter().flat_map(|frame| &frame.candidates);
        let features = &candidates.find(|candidate| format.has_camera(candidate.camera))?.features;
        Some(Self { name: features.extractor.clone(), format: features.descriptors.format() })
    }

    fn made(&self, features: &FeatureSet) -> bool {
        features.extractor == self.name && features.descriptors.format() == self.format
    }

    pub(super) fn write(extractor: Option<&Self>, out: &mut Writer) {
        let Some(Self { name, format }) = extractor else { return out.unsigned(0) };
        let kind = KINDS.iter().position(|kind| *kind == format.kind).unwrap_or_default();
        out.unsigned(kind as u64 + 1);
        out.unsigned(u64::from(format.width));
        out.unsigned(name.len() as u64);
        out.bytes(name.as_bytes());
    }

    pub(super) fn read(input: &mut Reader<'_>) -> Result<Option<Self>, ChunkError> {
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

/// Writes the candidates of an instant. Those of another extractor or format than the first one of a chunk are left out.
pub(super) fn write(
    out: &mut Writer,
    candidates: &[Candidate],
    extractor: Option<&Extractor>,
    format: ChunkFormat,
) {
    let of_extractor = |candidate: &&Candidate| {
        format.has_camera(candidate.camera)
            && extractor.is_some_and(|extractor| extractor.made(&candidate.features))
    };
    let written = || candidates.iter().filter(of_extractor);
    match format.schema {
        // The number of features stands for that of candidates, too.
        Schema::FirstCamera => {
            let first = written().next();
            out.unsigned(first.map_or(0, |candidate| candidate.features.len() as u64 + 1));
            if let Some(candidate) = first {
                write_features(out, &candidate.features);
            }
        }
        Schema::EachCamera => {
            out.unsigned(written().count() as u64);
            for candidate in written() {
                format.write_camera(out, candidate.camera);
                out.unsigned(candidate.features.len() as u64);
                write_features(out, &candidate.features);
            }
        }
    }
}

fn write_features(out: &mut Writer, features: &FeatureSet) {
    let steps = |value: f32| (f64::from(value).clamp(-MOST_PIXEL, MOST_PIXEL) * FEATURE_STEPS).round();
    features.pixels.as_flattened().iter().for_each(|value| out.signed(steps(*value) as i64));
    out.bytes(&features.descriptors.bytes);
}

/// Reads the candidates of an instant.
pub(super) fn read(
    input: &mut Reader<'_>,
    extractor: Option<&Extractor>,
    format: ChunkFormat,
) -> Result<Vec<Candidate>, ChunkError> {
    if format.schema == Schema::FirstCamera {
        let Some(count) = input.unsigned()?.checked_sub(1) else { return Ok(Vec::new()) };
        input.take::<Candidate>(1)?;
        return Ok(vec![Candidate { camera: 0, features: read_features(input, count, extractor)? }]);
    }
    let (mut candidates, count) = input.list::<Candidate>()?;
    for _ in 0..count {
        let camera = format.read_camera(input)?;
        if candidates.last().is_some_and(|last| last.camera >= camera) {
            return Err(ChunkError::Range("the camera of a candidate"));
        }
        let count = input.unsigned()?;
        candidates.push(Candidate { camera, features: read_features(input, count, extractor)? });
    }
    Ok(candidates)
}

/// The features of one image, whose number was read.
fn read_features(
    input: &mut Reader<'_>,
    count: u64,
    extractor: Option<&Extractor>,
) -> Result<FeatureSet, ChunkError> {
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
    Ok(FeatureSet { pixels, descriptors, extractor: name.clone() })
}
