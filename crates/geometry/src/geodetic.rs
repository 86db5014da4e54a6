//! Positions on the earth by latitude, longitude and altitude, and a frame about one of them: east, north, up.

use nalgebra::{Matrix3, Vector3};

/// Half axis of the ellipsoid WGS 84 at the equator, metres, and its flattening.
const EQUATOR_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);
/// Altitudes beyond are of no robot, metres.
const MAX_ALTITUDE_M: f64 = 1e5;
/// Iterations to the latitude of a position; below [`MAX_ALTITUDE_M`] each leaves less than a ten-thousandth of the error.
const LATITUDE_ITERATIONS: usize = 4;

/// A position on WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Degrees north.
    pub latitude_deg: f64,
    /// Degrees east.
    pub longitude_deg: f64,
    /// Above the ellipsoid, metres; above the sea it is another by up to 100 m.
    pub altitude_m: f64,
}

impl Geodetic {
    /// Whether it is on the earth: latitude and longitude within their ranges, the altitude within 100 km.
    pub fn is_valid(&self) -> bool {
        (-90.0..=90.0).contains(&self.latitude_deg)
            && (-180.0..=360.0).contains(&self.longitude_deg)
            && (-MAX_ALTITUDE_M..=MAX_ALTITUDE_M).contains(&self.altitude_m)
    }

    /// In the frame of the earth: z through the north pole, x through latitude and longitude 0; metres.
    pub fn in_earth(&self) -> Vector3<f64> {
        let (sine, cosine) = self.latitude_deg.to_radians().sin_cos();
        let normal_m = EQUATOR_M / (1.0 - ECCENTRICITY_SQUARED * sine * sine).sqrt();
        let (east, ahead) = self.longitude_deg.to_radians().sin_cos();
        let from_axis_m = (normal_m + self.altitude_m) * cosine;
        let along_axis_m = (normal_m * (1.0 - ECCENTRICITY_SQUARED) + self.altitude_m) * sine;
        Vector3::new(from_axis_m * ahead, from_axis_m * east, along_axis_m)
    }

    /// The inverse of [`Geodetic::in_earth`], to rounding precision within 100 km of the ellipsoid.
    ///
    /// # Arguments
    /// * `position`: in the frame of the earth, metres.
    ///
    /// # Returns
    /// With a longitude of -180 to 180 degrees.
    ///
    /// Source: Bowring, "Transformation from spatial to geographical coordinates", Survey Review 1976.
    pub fn from_earth(position: &Vector3<f64>) -> Self {
        let pole_m = EQUATOR_M * (1.0 - FLATTENING);
        let second_eccentricity_squared = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED);
        let (from_axis_m, along_axis_m) = (position.x.hypot(position.y), position.z);
        let mut latitude = along_axis_m.atan2((1.0 - ECCENTRICITY_SQUARED) * from_axis_m);
        for _ in 0..LATITUDE_ITERATIONS {
            let (sine, cosine) = ((1.0 - FLATTENING) * latitude.sin()).atan2(latitude.cos()).sin_cos();
            latitude = (along_axis_m + second_eccentricity_squared * pole_m * sine.powi(3))
                .atan2(from_axis_m - ECCENTRICITY_SQUARED * EQUATOR_M * cosine.powi(3));
        }
        let (sine, cosine) = latitude.sin_cos();
        let surface_m = EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED * sine * sine).sqrt();
        Self {
            latitude_deg: latitude.to_degrees(),
            longitude_deg: position.y.atan2(position.x).to_degrees(),
            altitude_m: from_axis_m * cosine + along_axis_m * sine - surface_m,
        }
    }
}

/// A frame that is tangential to the ellipsoid: x east, y north, z up.
///
/// ```
/// use geometry::{EnuFrame, Geodetic};
///
/// let origin = Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: 500.0 };
/// let above = Geodetic { altitude_m: 520.0, ..origin };
/// let position = EnuFrame::at(&origin).position(&above);
/// assert!((position - nalgebra::Vector3::new(0.0, 0.0, 20.0)).norm() < 1e-6);
/// assert!((EnuFrame::at(&origin).geodetic(&position).altitude_m - 520.0).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnuFrame {
    origin_in_earth: Vector3<f64>,
    enu_from_earth: Matrix3<f64>,
}

impl EnuFrame {
    /// The frame at an origin.
    pub fn at(origin: &Geodetic) -> Self {
        let (sine, cosine) = origin.latitude_deg.to_radians().sin_cos();
        let (east, ahead) = origin.longitude_deg.to_radians().sin_cos();
        let enu_from_earth = Matrix3::new(
            -east,
            ahead,
            0.0,
            -sine * ahead,
            -sine * east,
            cosine,
            cosine * ahead,
            cosine * east,
            sine,
        );
        Self { origin_in_earth: origin.in_earth(), enu_from_earth }
    }

    /// A position in this frame, metres. A kilometre away, level ground is 8 cm below it.
    pub fn position(&self, of: &Geodetic) -> Vector3<f64> {
        self.enu_from_earth * (of.in_earth() - self.origin_in_earth)
    }

    /// Latitude, longitude (-180 to 180 degrees) and altitude of a position in this frame (metres): the inverse of
    /// [`EnuFrame::position`].
    pub fn geodetic(&self, position: &Vector3<f64>) -> Geodetic {
        Geodetic::from_earth(&(self.enu_from_earth.transpose() * position + self.origin_in_earth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_position_is_found_again_by_its_latitude_longitude_and_altitude(
            latitude in -90.0..=90.0_f64,
            longitude in -180.0..=360.0_f64,
            altitude in -1e4..MAX_ALTITUDE_M,
            [east, north, up] in [-1e5..1e5_f64, -1e5..1e5_f64, -1e3..1e4_f64],
        ) {
            let origin = at(latitude, longitude, altitude);
            let frame = EnuFrame::at(&origin);
            let position = Vector3::new(east, north, up);
            let found = frame.geodetic(&position);
            prop_assert!((frame.position(&found) - position).norm() < 1e-6, "{:?}", found);
            let again = frame.geodetic(&Vector3::zeros());
            prop_assert!((again.latitude_deg - latitude).abs() < 1e-9 && (again.altitude_m - altitude).abs() < 1e-6);
            // Longitudes say less near a pole.
            let turned = (again.longitude_deg - longitude).to_radians().sin();
            prop_assert!(turned.abs() * latitude.to_radians().cos() < 1e-12, "{:?}", again);
        }
    }

    #[test]
    fn poles_have_a_latitude_and_an_altitude() {
        for (latitude, z) in [(90.0, 6_356_852.314_245), (-90.0, -6_356_852.314_245)] {
            let found = Geodetic::from_earth(&Vector3::new(0.0, 0.0, z));
            assert!(
                (found.latitude_deg - latitude).abs() < 1e-12 && (found.altitude_m - 100.0).abs() < 1e-5,
                "{found:?}"
            );
        }
    }

    fn at(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Geodetic {
        Geodetic { latitude_deg, longitude_deg, altitude_m }
    }

    #[test]
    fn places_whose_coordinates_are_known() {
        let near = |a: Vector3<f64>, b: [f64; 3], by: f64| assert!((a - Vector3::from(b)).amax() < by, "{a}");
        near(at(0.0, 0.0, 0.0).in_earth(), [6_378_137.0, 0.0, 0.0], 1e-6);
        near(at(0.0, 90.0, 10.0).in_earth(), [0.0, 6_378_147.0, 0.0], 1e-6);
        // The half axis of the poles, as WGS 84 states it.
        near(at(90.0, 0.0, 0.0).in_earth(), [0.0, 0.0, 6_356_752.314_245], 1e-5);
        near(at(-90.0, 50.0, 1.0).in_earth(), [0.0, 0.0, -6_356_753.314_245], 1e-5);
        // The Eiffel tower, to the digits in which it is printed.
        near(at(48.8562, 2.3508, 67.4).in_earth(), [4.2010e6, 1.7246e5, 4.7801e6], 60.0);
    }

    #[test]
    fn a_degree_is_as_long_as_the_curvature_says() {
        for latitude in [-70.0_f64, -12.0, 0.5, 48.0, 81.0] {
            let origin = at(latitude, 130.0, 0.0);
            let frame = EnuFrame::at(&origin);
            let step = 1e-4_f64;
            let squared = 1.0 - ECCENTRICITY_SQUARED * latitude.to_radians().sin().powi(2);
            let (meridian, normal) =
                (EQUATOR_M * (1.0 - ECCENTRICITY_SQUARED) / squared.powf(1.5), EQUATOR_M / squared.sqrt());
            let north = frame.position(&at(latitude + step, 130.0, 0.0));
            assert!((north.y - meridian * step.to_radians()).abs() < 1e-4, "{north}");
            let east = frame.position(&at(latitude, 130.0 + step, 0.0));
            assert!(
                (east.x - normal * latitude.to_radians().cos() * step.to_radians()).abs() < 1e-4,
                "{east}"
            );
            // The rest is the curvature of the ground.
            for across in [north.x, north.z, east.y, east.z] {
                assert!(across.abs() < 1e-4, "{north} {east}");
            }
        }
    }

    #[test]
    fn distances_are_those_in_the_earth_and_level_ground_falls_away() {
        let frame = EnuFrame::at(&at(48.0, 11.0, 500.0));
        let (a, b) = (at(48.01, 11.02, 480.0), at(47.99, 10.97, 530.0));
        let apart = (frame.position(&a) - frame.position(&b)).norm();
        assert!((apart - (a.in_earth() - b.in_earth()).norm()).abs() < 1e-8);
        let kilometre = frame.position(&at(48.009, 11.0, 500.0));
        assert!((kilometre.z + kilometre.y.powi(2) / (2.0 * 6.37e6)).abs() < 1e-3, "{kilometre}");
        assert!(
            !at(91.0, 0.0, 0.0).is_valid()
                && !at(0.0, f64::NAN, 0.0).is_valid()
                && at(48.0, 11.0, 500.0).is_valid()
        );
    }
}
