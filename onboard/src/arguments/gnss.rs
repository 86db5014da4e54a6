//! Switches of GNSS.

use anyhow::{Result, bail, ensure};
use clap::Args;
use estimator::GnssConfig;
use geometry::Geodetic;
use sensors::{CalibrationFiles, Contents, GnssSensor};

/// Heading of these switches in `--help`.
const HEADING: &str = "GNSS";

/// The antenna of GNSS.
#[derive(Args, Clone, Debug, Default)]
pub struct GnssArguments {
    /// Topic of GNSS (sensor_msgs/NavSatFix) in a bag, or with --source ros2 [default: none]
    #[arg(long, value_name = "TOPIC", help_heading = HEADING)]
    pub gnss_topic: Option<String>,
    /// Origin of the frame of the positions of --gnss-topic, or of --source native, which is that of the map: degrees, degrees, metres
    /// above the ellipsoid [default: that of gnss0/sensor.yaml in the folder of --calibration]
    #[arg(long, value_name = "LAT,LON,ALT", value_delimiter = ',', allow_hyphen_values = true, help_heading = HEADING)]
    pub gnss_origin: Vec<f64>,
    /// Where the antenna is in the frame of the IMU, metres [default: that of gnss0/sensor.yaml, or of a bag's /tf_static]
    ///
    /// The positions in mav0/gnss0/data.csv (ns, x, y, z and their standard deviations, metres, in the frame of the map; or latitude,
    /// longitude, altitude where sensor.yaml has an origin) hold the pose between matches with the map, and without any map.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true, help_heading = HEADING)]
    pub gnss_antenna: Vec<f64>,
    /// Time over which the errors of positions are alike, seconds [default: that of sensor.yaml, else 30]
    #[arg(long, value_name = "SECONDS", help_heading = HEADING)]
    pub gnss_correlation: Option<f64>,
    /// Do not use GNSS
    #[arg(long, conflicts_with_all = ["gnss_antenna", "gnss_correlation"], help_heading = HEADING)]
    pub no_gnss: bool,
}

impl GnssArguments {
    /// Names the topic and the origin of its positions in a recording; one that is not given is looked for in its calibration.
    ///
    /// # Errors
    /// The origin is no place on the earth.
    pub fn name_topic(&self, files: &mut CalibrationFiles) -> Result<()> {
        files.gnss_topic.clone_from(&self.gnss_topic);
        files.gnss_origin = self.origin()?;
        let is_of_topic = files.gnss_origin.is_none() || files.gnss_topic.is_some();
        ensure!(
            is_of_topic,
            "--gnss-origin needs --gnss-topic: a folder has its origin in gnss0/sensor.yaml"
        );
        Ok(())
    }

    /// `--gnss-origin`.
    ///
    /// # Errors
    /// It is no place on the earth.
    pub fn origin(&self) -> Result<Option<Geodetic>> {
        let origin = match *self.gnss_origin.as_slice() {
            [] => return Ok(None),
            [latitude_deg, longitude_deg, altitude_m] => Geodetic { latitude_deg, longitude_deg, altitude_m },
            _ => bail!("--gnss-origin takes three numbers separated by commas"),
        };
        ensure!(
            origin.is_valid(),
            "--gnss-origin takes latitude and longitude in degrees, and the altitude in metres"
        );
        Ok(Some(origin))
    }

    /// How live positions are taken in: the origin of the switches, else that of the calibration.
    ///
    /// # Errors
    /// As [`Self::origin`]; a topic is named, and nothing states an origin.
    pub fn live_sensor(&self, calibrated: Option<GnssSensor>) -> Result<GnssSensor> {
        let sensor = calibrated.unwrap_or_default();
        let origin = self.origin()?.or(sensor.origin);
        ensure!(
            self.gnss_topic.is_none() || origin.is_some(),
            "--gnss-topic: the origin of the frame of its positions is not known: give --gnss-origin, or origin in mav0/gnss0/sensor.yaml of \
             the folder of --calibration"
        );
        Ok(GnssSensor { origin, ..sensor })
    }

    /// Whether a robot is told where its antenna is: by the switches, by its calibration or by the estimator's settings, which have it.
    pub fn is_expected(&self, settled: Option<&GnssConfig>) -> bool {
        !self.no_gnss && (settled.is_some() || !self.gnss_antenna.is_empty())
    }

    /// The antenna that is used: that of the switches, else that of the settings; none for a source without positions, and where it is
    /// not known where it is, which is logged.
    ///
    /// # Errors
    /// A switch that cannot be used, or positions that were asked for and are not there.
    pub fn gnss(&self, settled: Option<GnssConfig>, contents: Contents) -> Result<Option<GnssConfig>> {
        if self.no_gnss {
            return Ok(None);
        }
        if !contents.gnss {
            ensure!(
                self.gnss_antenna.is_empty() && self.gnss_correlation.is_none(),
                "--gnss-antenna, --gnss-correlation: there are no positions; a folder has them in mav0/gnss0/data.csv, a bag or ROS 2 in the \
                 topic that --gnss-topic names"
            );
            return Ok(None);
        }
        let antenna = match *self.gnss_antenna.as_slice() {
            [] => None,
            [x, y, z] => Some([x, y, z]),
            _ => bail!("--gnss-antenna takes three numbers separated by commas, in metres"),
        };
        let Some(mut gnss) = settled.or_else(|| antenna.map(GnssConfig::at)) else {
            tracing::warn!(
                "the recording has positions of GNSS, and they are not used: give --gnss-antenna, or antenna in gnss0/sensor.yaml, or \
                 record /tf_static with the frame of the antenna"
            );
            return Ok(None);
        };
        gnss.antenna_position_m = antenna.unwrap_or(gnss.antenna_position_m);
        gnss.correlation_time_s = self.gnss_correlation.unwrap_or(gnss.correlation_time_s);
        Ok(Some(gnss))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        gnss: GnssArguments,
    }

    fn given(line: &str) -> GnssArguments {
        Line::try_parse_from(std::iter::once("robot").chain(line.split_whitespace())).unwrap().gnss
    }

    #[test]
    fn a_topic_needs_an_origin_on_the_earth_by_the_switch_or_the_calibration() {
        let mut files = CalibrationFiles::default();
        given("--gnss-topic /fix --gnss-origin -33.9,151.2,40").name_topic(&mut files).unwrap();
        assert_eq!(files.gnss_topic.as_deref(), Some("/fix"));
        assert_eq!(files.gnss_origin.map(|origin| origin.latitude_deg), Some(-33.9));
        assert!(given("--gnss-topic /fix --gnss-origin 151.2,-33.9,40").name_topic(&mut files).is_err());
        given("--gnss-topic /fix").name_topic(&mut files).unwrap();
        assert_eq!(files.gnss_origin, None, "it may be in the calibration");
        assert!(given("--gnss-origin 48,11,500").name_topic(&mut CalibrationFiles::default()).is_err());
        let native = given("--gnss-origin 48,11,500").live_sensor(None).unwrap();
        assert_eq!(native.origin.map(|origin| origin.altitude_m), Some(500.0));
        let topic = given("--gnss-topic /fix");
        assert_eq!(topic.live_sensor(Some(native)).unwrap(), native);
        let unknown = topic.live_sensor(Some(GnssSensor::default())).unwrap_err().to_string();
        assert!(unknown.contains("--gnss-origin") && unknown.contains("gnss0/sensor.yaml"), "{unknown}");
    }

    #[test]
    fn a_switch_overrides_the_calibration_and_gnss_needs_positions() {
        let with = Contents { gnss: true, ..Contents::default() };
        let stated = GnssConfig::at([0.0, 0.1, 0.8]);
        assert_eq!(given("").gnss(Some(stated), with).unwrap(), Some(stated));
        assert_eq!(given("").gnss(Some(stated), Contents::default()).unwrap(), None);
        assert_eq!(given("--no-gnss").gnss(Some(stated), with).unwrap(), None);
        assert_eq!(given("").gnss(None, with).unwrap(), None, "the antenna is not known");
        let line = "--gnss-antenna -0.1,0,0.5 --gnss-correlation 5";
        let switched = given(line).gnss(Some(stated), with).unwrap().unwrap();
        assert_eq!((switched.antenna_position_m, switched.correlation_time_s), ([-0.1, 0.0, 0.5], 5.0));
        assert_eq!(
            given("--gnss-antenna 1,2,3").gnss(None, with).unwrap(),
            Some(GnssConfig::at([1.0, 2.0, 3.0]))
        );
        assert!(given(line).gnss(None, Contents::default()).unwrap_err().to_string().contains("gnss0"));
        assert!(given("--gnss-antenna 1,2").gnss(None, with).is_err());
    }
}
