//! `wheels0/sensor.yaml`: what a base is, its geometry, and how its wheels are measured.

use crate::yaml::{check_positive, parse, pose_from_matrix, read_text};
use crate::{CalibrationError, WheelSensor};
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;
use types::{BaseKind, Encoder, WheelBase};

const KIND: &str = "sensor.yaml";
/// Bits of a counter whose width is not stated.
const COUNTER_BITS: u32 = 32;

#[derive(Deserialize)]
struct Matrix4Yaml {
    data: Vec<f64>,
}

/// Lengths in metres, angles in rad.
#[derive(Deserialize)]
struct WheelsYaml {
    #[serde(rename = "T_BS")]
    body_from_sensor: Matrix4Yaml,
    #[serde(default)]
    base: BaseKind,
    radius: Option<f64>,
    radius_left: Option<f64>,
    radius_right: Option<f64>,
    radii: Option<Vec<f64>>,
    track: Option<f64>,
    wheelbase: Option<f64>,
    reach: Option<f64>,
    sideways_scale: Option<f64>,
    #[serde(default)]
    steering_offset: f64,
    noise: Option<f64>,
    angle_noise: Option<f64>,
    counts_per_revolution: Option<f64>,
    counter_bits: Option<u32>,
}

/// Reads the `sensor.yaml` of the wheels: `base`, its lengths (m), `T_BS`, the pose of the base in the body frame, and where they are known `noise`, that
/// of a reading (rad/s), and `counts_per_revolution` and `counter_bits` of encoders.
///
/// | `base` | lengths |
/// |---|---|
/// | `differential` (also without `base`) | `radius_left`, `radius_right`, or `radius`; `track` |
/// | `ackermann` | `radius`, `wheelbase`; `steering_offset` (rad) where it is known |
/// | `mecanum`, `omni3` | `radii`, or `radius`; `reach`; `sideways_scale` (a ratio) where it is known |
/// | `omni4` | `radii`, or `radius`; `reach` |
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_wheels(path: &Path) -> Result<WheelSensor, CalibrationError> {
    wheels_of_text(path, &read_text(path)?)
}

/// Reads the wheels from the text of such a file. `path`: what it is called in errors.
///
/// # Errors
/// As [`read_wheels`].
pub fn wheels_of_text(path: &Path, text: &str) -> Result<WheelSensor, CalibrationError> {
    let yaml: WheelsYaml = parse(path, KIND, text)?;
    let base = yaml.wheel_base(path)?;
    for (name, value) in base.parameter_names().iter().zip(base.parameters()).take(base.kind().wheels() + 1) {
        check_positive(path, name, value)?;
    }
    check_positive(path, "noise", yaml.noise.unwrap_or(1.0))?;
    check_positive(path, "angle_noise", yaml.angle_noise.unwrap_or(1.0))?;
    let encoder = yaml.encoder().transpose();
    let encoder = encoder.map_err(|error| CalibrationError::entry(path, error.to_string()))?;
    Ok(WheelSensor {
        sigma_speed_rad_s: yaml.noise,
        sigma_angle_rad: yaml.angle_noise.or_else(|| encoder.as_ref().map(Encoder::sigma_angle_rad)),
        encoder,
        ..WheelSensor::new(base, pose_from_matrix(path, "T_BS", &yaml.body_from_sensor.data)?)
    })
}

/// The text of such a file, for readings that are speeds: it names no encoders.
pub fn text_of_wheels(wheels: &WheelSensor) -> String {
    let base = &wheels.base;
    let mut text = format!("sensor_type: wheels\nbase: {}\n", base.kind());
    let (rotation, position) =
        (wheels.imu_from_base.rotation.to_rotation_matrix(), wheels.imu_from_base.translation);
    let mut cells: Vec<String> = Vec::new();
    for row in 0..3 {
        cells.extend((0..3).map(|column| rotation[(row, column)].to_string()));
        cells.push(position[row].to_string());
    }
    let _ = writeln!(text, "T_BS:\n  cols: 4\n  rows: 4\n  data: [{}, 0, 0, 0, 1]", cells.join(", "));
    let size = base.size_m();
    let _ = match *base {
        WheelBase::Differential { radius_left_m, radius_right_m, .. } => {
            writeln!(text, "radius_left: {radius_left_m}\nradius_right: {radius_right_m}\ntrack: {size}")
        }
        WheelBase::Ackermann { radius_m, steering_offset_rad, .. } => {
            writeln!(text, "radius: {radius_m}\nwheelbase: {size}\nsteering_offset: {steering_offset_rad}")
        }
        _ => {
            let radii = &base.parameters()[..base.kind().wheels()];
            writeln!(text, "radii: {radii:?}\nreach: {size}")
        }
    };
    if let WheelBase::Mecanum { sideways_scale, .. } | WheelBase::Omni3 { sideways_scale, .. } = *base {
        let _ = writeln!(text, "sideways_scale: {sideways_scale}");
    }
    for (name, sigma) in [("noise", wheels.sigma_speed_rad_s), ("angle_noise", wheels.sigma_angle_rad)] {
        let _ = sigma.map_or(Ok(()), |sigma| writeln!(text, "{name}: {sigma}"));
    }
    text
}

impl WheelsYaml {
    /// The base with its lengths.
    fn wheel_base(&self, path: &Path) -> Result<WheelBase, CalibrationError> {
        let (name, size) = match self.base {
            BaseKind::Differential => ("track", self.track),
            BaseKind::Ackermann => ("wheelbase", self.wheelbase),
            _ => ("reach", self.reach),
        };
        let missing = |name: &str| {
            CalibrationError::entry(path, format!("{name} is missing; a {} base needs it", self.base))
        };
        let mut base = WheelBase::new(self.base, 1.0, size.ok_or_else(|| missing(name))?);
        let both = self.radius_left.zip(self.radius_right).map(|(left, right)| vec![left, right]);
        let radii = self.radii.clone().or(both).or_else(|| self.radius.map(|radius| vec![radius]));
        let expected =
            if self.base == BaseKind::Differential { "radius_left and radius_right" } else { "radius" };
        if !base.set_radii_m(&radii.ok_or_else(|| missing(expected))?) {
            let problem = format!("a {} base has {} radii", self.base, self.base.wheels());
            return Err(CalibrationError::entry(path, problem));
        }
        if let WheelBase::Ackermann { steering_offset_rad, .. } = &mut base {
            *steering_offset_rad = self.steering_offset;
        }
        if let Some(scale) = self.sideways_scale {
            check_positive(path, "sideways_scale", scale)?;
            if !base.set_sideways_scale(scale) {
                let problem = format!("a {} base has no sideways_scale; mecanum and omni3 have", self.base);
                return Err(CalibrationError::entry(path, problem));
            }
        }
        Ok(base)
    }

    fn encoder(&self) -> Option<Result<Encoder, types::EncoderError>> {
        let counts = self.counts_per_revolution?;
        Some(Encoder::new(counts, self.counter_bits.unwrap_or(COUNTER_BITS)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Pose, rotation};
    use nalgebra::Vector3;

    fn read(text: &str) -> Result<WheelSensor, CalibrationError> {
        wheels_of_text(Path::new("sensor.yaml"), text)
    }

    #[test]
    fn each_base_is_read_as_it_is_written() {
        let imu_from_base =
            Pose::new(rotation::exp(&Vector3::new(0.1, 0.2, 0.3)), Vector3::new(-0.1, 0.0, -0.25));
        for kind in BaseKind::ALL {
            let mut base = WheelBase::new(kind, 0.25, 0.5);
            base.add(&[0.125, -0.125, 0.25]);
            base.set_sideways_scale(0.875);
            let written =
                WheelSensor { sigma_speed_rad_s: Some(0.03), ..WheelSensor::new(base, imu_from_base) };
            let found = read(&text_of_wheels(&written)).unwrap();
            assert!(found.imu_from_base.local(&imu_from_base).norm() < 1e-12);
            assert_eq!(WheelSensor { imu_from_base, ..found }, written);
        }
    }

    #[test]
    fn encoders_are_stated_with_their_steps_and_what_is_missing_is_named() {
        let base = "T_BS: {data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}\n";
        let text = format!("{base}radius: 0.1\ntrack: 0.5\ncounts_per_revolution: 1024\ncounter_bits: 16\n");
        let found = read(&text).unwrap();
        assert_eq!(found.base, WheelBase::new(BaseKind::Differential, 0.1, 0.5));
        assert_eq!(found.encoder, Some(Encoder::new(1024.0, 16).unwrap()));
        assert!((found.sigma_angle_rad.unwrap() - 0.00177).abs() < 1e-5);
        for (text, problem) in [
            ("base: ackermann\nradius: 0.3", "wheelbase is missing"),
            ("base: mecanum\nreach: 0.4", "radius is missing"),
            ("base: omni3\nreach: 0.4\nradii: [0.1, 0.1]", "a omni3 base has 3 radii"),
            ("base: omni4\nreach: 0.4\nradius: 0.1\nsideways_scale: 0.9", "has no sideways_scale"),
            ("base: mecanum\nreach: 0.4\nradius: 0.1\nsideways_scale: 0", "sideways_scale is 0"),
            ("radius: -0.3\ntrack: 0.5", "radius_left_m is -0.3"),
            ("radius: 0.3\ntrack: 0.5\ncounts_per_revolution: -4", "-4 counts per revolution"),
        ] {
            let error = read(&format!("{base}{text}\n")).unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
        }
    }
}
