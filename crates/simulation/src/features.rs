//! The feature extractor for place recognition: visible landmarks with noisy descriptors, among clutter.

use super::SimulationOptions;
use super::exposure::Exposure;
use super::random::{Purpose, normal, stream};
use super::tracks::{rounded, visible};
use super::world::{DESCRIPTOR_BYTES, Landmark};
use nalgebra::Vector2;
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use sensors::CameraSensor;
use std::ops::Range;

/// The extractor of one run.
pub(crate) struct Extractor<'a> {
    options: &'a SimulationOptions,
    rng: StdRng,
}

impl<'a> Extractor<'a> {
    pub(crate) fn new(options: &'a SimulationOptions, run: u64) -> Self {
        Self { options, rng: stream(options.seed, run, Purpose::Features) }
    }

    /// The features of one image.
    pub(crate) fn extract(
        &mut self,
        exposure: &Exposure<'_>,
        sensor: &CameraSensor,
        landmarks: &[Landmark],
    ) -> FeatureSet {
        let options = self.options;
        let rng = &mut self.rng;
        let mut seen = visible(options, exposure, sensor, landmarks);
        seen.retain(|_| rng.random_bool(options.repeatability));
        seen.shuffle(rng);
        seen.truncate(options.max_features);
        let mut features: Vec<(Vector2<f64>, [u8; DESCRIPTOR_BYTES])> = Vec::new();
        for (landmark, pixel) in seen {
            let noise = Vector2::new(normal(rng), normal(rng)) * options.sigma_feature_px;
            features.push((pixel + noise, flip_bits(rng, options, landmarks[landmark].descriptor)));
        }
        let (width, height) = (f64::from(sensor.camera.width), f64::from(sensor.camera.height));
        for _ in 0..options.clutter {
            features.push((
                Vector2::new(rng.random_range(0.0..width), rng.random_range(0.0..height)),
                rng.random(),
            ));
        }
        features.shuffle(rng);
        features.retain(|(pixel, _)| sensor.camera.contains(pixel));
        let pixels =
            features.iter().map(|(pixel, _)| rounded(*pixel)).map(|pixel| [pixel.x as f32, pixel.y as f32]);
        FeatureSet {
            pixels: pixels.collect(),
            descriptors: Descriptors {
                kind: DescriptorKind::Binary,
                width: DESCRIPTOR_BYTES as u16,
                bytes: features.iter().flat_map(|(_, descriptor)| descriptor).copied().collect(),
            },
            extractor: String::new(),
        }
    }
}

/// Flips each bit with a given probability.
fn flip_bits(
    rng: &mut StdRng,
    options: &SimulationOptions,
    descriptor: [u8; DESCRIPTOR_BYTES],
) -> [u8; DESCRIPTOR_BYTES] {
    descriptor.map(|byte| {
        (0..8).fold(byte, |byte, bit| byte ^ (u8::from(rng.random_bool(options.bit_flips)) << bit))
    })
}

/// The drop-outs of a run: stretches without features, as in fog, behind a lorry, in a street that was rebuilt.
///
/// Fractions of the run, in order, without overlap, none in the first tenth; they add up to about
/// `options.dropout_fraction`.
pub(crate) fn dropout_intervals(options: &SimulationOptions, run: u64) -> Vec<Range<f64>> {
    const STRETCHES: usize = 3;
    const SPARED: f64 = 0.1;
    let mut rng = stream(options.seed, run, Purpose::Dropouts);
    let slot = (1.0 - SPARED) / STRETCHES as f64;
    (0..STRETCHES)
        .map(|index| {
            let length = (options.dropout_fraction / STRETCHES as f64).clamp(0.0, slot);
            let begin = SPARED + slot * index as f64 + rng.random_range(0.0..=1.0) * (slot - length);
            begin..begin + length
        })
        .filter(|stretch| !stretch.is_empty())
        .collect()
}
