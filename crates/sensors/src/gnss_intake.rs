//! Positions of GNSS as they are taken in, be it from a folder, a bag or live: in the frame of the map, with a covariance.

use crate::{GnssReading, GnssSensor};
use geometry::{EnuFrame, Geodetic};
use nalgebra::{Matrix3, Vector3};

/// Positions farther than this from the origin are of another place, metres.
const MAX_DISTANCE_M: f64 = 1e5;

/// Why a position cannot be taken in.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GnssProblem {
    /// The columns are no latitude, longitude and altitude.
    #[error(
        "it is no latitude, longitude and altitude, which sensor.yaml says by its origin: write x, y, z in the frame of the map and no origin"
    )]
    NotOnEarth,
    /// It is far from the origin.
    #[error(
        "it is {kilometres:.0} km from the origin: correct the origin (of gnss0/sensor.yaml, or --gnss-origin), or the order of latitude and longitude"
    )]
    Far {
        /// How far.
        kilometres: f64,
    },
    /// Nobody says how uncertain it is.
    #[error(
        "its standard deviations are not known: add three columns of them (m), or noise to gnss0/sensor.yaml"
    )]
    NoNoise,
}

/// From positions as they are recorded to those in the frame of the map.
#[derive(Clone, Copy, Debug)]
pub struct GnssIntake {
    frame: Option<EnuFrame>,
    sigma_m: Option<Vector3<f64>>,
}

impl GnssIntake {
    /// As the calibration of the antenna states it.
    pub fn new(sensor: &GnssSensor) -> Self {
        Self { frame: sensor.origin.as_ref().map(EnuFrame::at), sigma_m: sensor.sigma_m }
    }

    /// The reading of a position.
    ///
    /// # Arguments
    /// * `position`: in the frame of the map, or latitude, longitude and altitude.
    /// * `covariance`: east, north and up, m^2, where it is stated.
    ///
    /// # Errors
    /// [`GnssProblem`].
    pub fn take(
        &self,
        stamp_ns: i64,
        position: &Vector3<f64>,
        covariance: Option<Matrix3<f64>>,
    ) -> Result<GnssReading, GnssProblem> {
        let of_noise =
            || self.sigma_m.map(|sigma_m| Matrix3::from_diagonal(&sigma_m.component_mul(&sigma_m)));
        let covariance = covariance.or_else(of_noise).ok_or(GnssProblem::NoNoise)?;
        let position = match &self.frame {
            None => *position,
            Some(frame) => {
                let geodetic =
                    Geodetic { latitude_deg: position.x, longitude_deg: position.y, altitude_m: position.z };
                if !geodetic.is_valid() {
                    return Err(GnssProblem::NotOnEarth);
                }
                let position = frame.position(&geodetic);
                if position.norm() > MAX_DISTANCE_M {
                    return Err(GnssProblem::Far { kilometres: position.norm() * 1e-3 });
                }
                position
            }
        };
        Ok(GnssReading { stamp_ns, position, covariance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latitude_and_longitude_are_turned_to_the_frame_of_the_origin() {
        let origin = Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: 500.0 };
        let sigma_m = Some(Vector3::new(0.5, 0.6, 1.5));
        let intake = GnssIntake::new(&GnssSensor { origin: Some(origin), sigma_m, ..GnssSensor::default() });
        let taken = intake.take(7, &Vector3::new(48.001, 11.0, 503.0), None).unwrap();
        assert!((taken.position - Vector3::new(0.0, 111.2, 3.0)).norm() < 0.1, "{}", taken.position);
        assert!((taken.covariance[(2, 2)] - 2.25).abs() < 1e-12);
        let stated = intake.take(7, &Vector3::new(48.0, 11.0, 500.0), Some(Matrix3::identity() * 9.0));
        assert_eq!(stated.unwrap().covariance, Matrix3::identity() * 9.0);
        let swapped = intake.take(7, &Vector3::new(11.0, 48.0, 500.0), None).unwrap_err();
        assert!(swapped.to_string().contains("order of latitude and longitude"), "{swapped}");
        let metres = intake.take(7, &Vector3::new(120.0, -3.0, 1.0), None).unwrap_err();
        assert_eq!(metres, GnssProblem::NotOnEarth);
    }

    #[test]
    fn positions_in_the_map_are_taken_as_they_are_and_need_a_noise() {
        let intake = GnssIntake::new(&GnssSensor::default());
        let position = Vector3::new(120.0, -3.0, 1.0);
        assert_eq!(intake.take(7, &position, None), Err(GnssProblem::NoNoise));
        assert_eq!(intake.take(7, &position, Some(Matrix3::identity())).unwrap().position, position);
    }
}
