//! What several messages have: poses, cameras, features, names.

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use protocol::*;

pub fn poses() -> impl Strategy<Value = PoseWithCovariance> {
    let factor = prop::array::uniform32(-1.0..1.0f64);
    (vec(-1.0..1.0f64, 4), prop::array::uniform3(-1e4..1e4f64), factor, 1e-6..1e3f64)
        .prop_filter("a rotation needs a direction", |(rotation, ..)| rotation.iter().any(|x| x.abs() > 1e-3))
        .prop_map(|(rotation, translation, factor, scale)| {
            let factor = Matrix6::from_fn(|row, column| factor[(6 * row + column) % 32]);
            let product = factor * factor.transpose() * scale;
            PoseWithCovariance {
                pose: Pose {
                    rotation: UnitQuaternion::new_normalize(Quaternion::from(nalgebra::Vector4::from_vec(
                        rotation,
                    ))),
                    translation: Vector3::from(translation),
                },
                covariance: (product + product.transpose()) * 0.5,
            }
        })
}

pub fn cameras() -> impl Strategy<Value = Camera> {
    let distortion = prop_oneof![
        Just(Distortion::None),
        Just(Distortion::RadialTangential([-0.283, 0.0739, 0.00019, 1.7e-5])),
        Just(Distortion::Equidistant([-0.01, 0.02, -0.03, 0.004])),
        (0.1..1.5f64).prop_map(Distortion::Fov),
        Just(Distortion::Rational([0.51, -2.7, 3e-4, -1e-4, 1.5, 0.4, -2.5, 1.4, 1e-3, -4e-4, 8e-4, 3e-4])),
        Just(Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, -4e-4, -0.004, 8e-4, 6e-4, -9e-4])),
        (-0.9..0.9f64, 0.0..1.0f64).prop_map(|(xi, alpha)| Distortion::DoubleSphere { xi, alpha }),
        (0.0..1.0f64, 0.5..2.0f64).prop_map(|(alpha, beta)| Distortion::Eucm { alpha, beta }),
        (0.0..3.0f64).prop_map(|xi| Distortion::Omni { xi, distortion: [-0.07, 0.4, -1e-3, 8e-4] }),
    ];
    (
        1..4000u32,
        1..4000u32,
        prop::array::uniform2(100.0..1000.0f64),
        prop::array::uniform2(-1.0..2.0f64),
        distortion,
    )
        .prop_map(|(width, height, focal, [u, v], distortion)| Camera {
            width,
            height,
            focal,
            // In images, as the plausible ones are.
            centre: [u * f64::from(width), v * f64::from(height)],
            distortion,
        })
}

pub fn features() -> impl Strategy<Value = FeatureSet> {
    let binary = (1..65u16).prop_map(|width| (DescriptorKind::Binary, width));
    let float = (1..17u16).prop_map(|dimension| (DescriptorKind::Float, 4 * dimension));
    let int8 = (1..65u16).prop_map(|width| (DescriptorKind::Int8, width));
    (prop_oneof![binary, float, int8], 0..12usize).prop_flat_map(|((kind, width), count)| {
        let size = usize::from(width) * count;
        let bytes = match kind {
            DescriptorKind::Binary | DescriptorKind::Int8 => vec(any::<u8>(), size).boxed(),
            DescriptorKind::Float => vec(-1e3..1e3f32, size / 4)
                .prop_map(|numbers| numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
                .boxed(),
        };
        (vec(pixels(), count), bytes).prop_map(move |(pixels, bytes)| FeatureSet {
            pixels,
            descriptors: Descriptors { kind, width, bytes },
            extractor: ["", "sift-1", "xfeat-1"][count % 3].to_owned(),
        })
    })
}

pub fn pixels() -> impl Strategy<Value = [f32; 2]> {
    prop::array::uniform2(-10.0..4000.0f32)
}

pub fn points() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(-1e3..1e3f64)
}

pub fn directions() -> impl Strategy<Value = [f64; 3]> {
    points()
        .prop_filter("a direction needs a length", |point| Vector3::from(*point).norm() > 1e-3)
        .prop_map(|point| Vector3::from(point).normalize().into())
}

pub fn names() -> impl Strategy<Value = String> {
    "[a-zA-Z0-9_.é-]{1,30}"
}

pub fn priors() -> impl Strategy<Value = Option<PosePrior>> {
    option::of(poses().prop_map(|global_from_camera| PosePrior { global_from_camera }))
}

pub fn identities() -> impl Strategy<Value = MapIdentity> {
    any::<[u8; 16]>().prop_map(MapIdentity::from_bytes)
}

pub fn keyframes() -> impl Strategy<Value = KeyframeRecord> {
    (any::<u64>(), any::<i64>(), poses(), cameras()).prop_map(
        |(id, stamp_ns, global_from_keyframe, camera)| KeyframeRecord {
            id,
            stamp_ns,
            global_from_keyframe,
            camera,
        },
    )
}
