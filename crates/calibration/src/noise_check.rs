//! Whether the stated noise of an IMU is that of one.

use std::ops::RangeInclusive;
use std::path::Path;

/// Usual values and unit of the gyroscope's noise and walk, and of the accelerometer's.
const USUAL: [(RangeInclusive<f64>, &str); 4] = [
    (1e-5..=1e-1, "rad/s/sqrt(Hz)"),
    (1e-7..=1e-1, "rad/s^2/sqrt(Hz)"),
    (1e-4..=1.0, "m/s^2/sqrt(Hz)"),
    (1e-7..=1e-1, "m/s^3/sqrt(Hz)"),
];

/// Warns of noise densities that no usual IMU has.
///
/// # Arguments
/// * `densities`: name and value of the gyroscope's noise and walk, and of the accelerometer's.
pub(crate) fn warn_of_implausible(path: &Path, densities: &[(&str, f64); 4]) {
    for problem in implausible(densities) {
        tracing::warn!("{}: {problem}", path.display());
    }
}

fn implausible(densities: &[(&str, f64); 4]) -> Vec<String> {
    let mut problems: Vec<String> = densities
        .iter()
        .zip(&USUAL)
        .filter(|((_, value), (usual, _))| !usual.contains(value))
        .map(|((name, value), (usual, unit))| {
            format!(
                "{name} is {value:e} {unit}, where an IMU has {:e} to {:e}: check its unit (rad, not deg; m/s^2, not g), and that it is \
                 a density of continuous time, not the standard deviation or the variance of a reading",
                usual.start(),
                usual.end()
            )
        })
        .collect();
    let [(of_gyroscope, gyroscope), _, (of_accelerometer, accelerometer), _] = densities;
    if gyroscope > accelerometer {
        problems.push(format!(
            "{of_gyroscope} is {gyroscope:e} rad/s/sqrt(Hz), more than {of_accelerometer}, {accelerometer:e} m/s^2/sqrt(Hz), where an IMU \
             has less: check that they are not exchanged, and that neither is in deg or g"
        ));
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(values: [f64; 4]) -> Vec<String> {
        let [gyroscope, gyroscope_walk, accelerometer, accelerometer_walk] = values;
        implausible(&[
            ("gyroscope_noise_density", gyroscope),
            ("gyroscope_random_walk", gyroscope_walk),
            ("accelerometer_noise_density", accelerometer),
            ("accelerometer_random_walk", accelerometer_walk),
        ])
    }

    #[test]
    fn noise_that_no_imu_has_is_named_with_its_value() {
        assert!(problems([1.6968e-4, 1.9393e-5, 2.0e-3, 3.0e-3]).is_empty(), "EuRoC");
        let low = problems([1e-9, 1.9393e-5, 2.0e-3, 3.0e-3]);
        assert!(low.len() == 1 && low[0].contains("gyroscope_noise_density is 1e-9 rad/s"), "{low:?}");
        let walk = problems([1.6968e-4, 1.9393e-5, 2.0e-3, 3.0]);
        assert!(walk.len() == 1 && walk[0].contains("1e-7 to 1e-1"), "{walk:?}");
        let exchanged = problems([2.0e-3, 3.0e-3, 1.6968e-4, 1.9393e-5]);
        assert!(exchanged.len() == 1 && exchanged[0].contains("exchanged"), "{exchanged:?}");
        assert_eq!(problems([1e2, 1.9393e-5, 2.0e-3, 3.0e-3]).len(), 2);
    }
}
