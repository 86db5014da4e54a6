//! Switches of the wheels.

use anyhow::{Result, bail, ensure};
use clap::Args;
use estimator::WheelConfig;
use geometry::Pose;
use robot::wheel_config;
use sensors::{CalibrationFiles, Contents, WheelReadings, WheelSensor};

/// Heading of these switches in `--help`.
const HEADING: &str = "Wheels";

/// Geometry of the wheels of a differential drive.
#[derive(Args, Clone, Debug, Default)]
pub struct WheelArguments {
    /// Topic of the wheels: sensor_msgs/JointState with their speeds, or nav_msgs/Odometry, of which the velocity is used: in a bag, or
    /// with --source ros2 [default: none]
    ///
    /// With --source ros2 it is of sensor_msgs/JointState where --wheel-radius or --wheel-joints is given.
    /// The pose of nav_msgs/Odometry is not used, and its velocity must be that of the encoders: not one that cameras or an IMU have
    /// improved. Its scale and turns are estimated, from 2 %.
    #[arg(long, value_name = "TOPIC", help_heading = HEADING)]
    pub wheel_topic: Option<String>,
    /// Joints of the left and the right wheel in sensor_msgs/JointState [default: those named wheel, and left or right; several of
    /// a side count by their mean]
    #[arg(long, value_name = "LEFT,RIGHT", value_delimiter = ',', num_args = 2, requires = "wheel_topic", help_heading = HEADING)]
    pub wheel_joints: Vec<String>,
    /// Radius of the wheels, metres; two of them separated by a comma are the left and the right one [default: that of
    /// wheels0/sensor.yaml]
    ///
    /// With --wheel-track it makes the speeds in mav0/wheels0/data.csv (stamp, left, right; ns, rad/s) odometry: one camera
    /// that drives straight knows its scale, and a slip is left out. Radii, track, the pose of the base and the time offset
    /// are estimated during the run, from 2 %, 2 %, 1 degree, 2 cm and 5 ms; the result is in summary.json. Noise and these
    /// standard deviations are in the settings file, under wheels.
    #[arg(long, value_name = "M[,M]", value_delimiter = ',', requires = "wheel_track", help_heading = HEADING)]
    pub wheel_radius: Vec<f64>,
    /// Distance between the wheels, metres
    #[arg(long, value_name = "M", requires = "wheel_radius", help_heading = HEADING)]
    pub wheel_track: Option<f64>,
    /// Where the point between the wheels on the floor is in the frame of the IMU, metres; the base looks along x of the IMU
    /// [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true, help_heading = HEADING)]
    pub base_in_imu: Vec<f64>,
    /// Do not use the wheels
    #[arg(long, conflicts_with_all = ["wheel_radius", "base_in_imu"], help_heading = HEADING)]
    pub no_wheels: bool,
}

impl WheelArguments {
    /// The wheels that are used: those of the switches, else those of the settings; none for a source without readings, and
    /// where their geometry is not known, which is logged.
    ///
    /// # Errors
    /// A switch that cannot be used, or wheels that were asked for and are not there.
    pub fn wheels(&self, settled: Option<WheelConfig>, contents: Contents) -> Result<Option<WheelConfig>> {
        if self.no_wheels {
            return Ok(None);
        }
        let (given, lacks) = match contents.wheels {
            Some(WheelReadings::Speeds) => {
                let lacks = "wheels whose geometry is not known, and they are not used: give --wheel-radius and --wheel-track (and \
                             --base-in-imu), or wheels0/sensor.yaml";
                (self.given(settled)?, lacks)
            }
            Some(WheelReadings::BaseVelocities) => {
                let lacks = "a base whose pose on the IMU is not known, and its velocities are not used: give --base-in-imu, or record \
                             /tf_static with the frame of the base";
                (self.of_base_velocities(settled)?, lacks)
            }
            None => {
                ensure!(
                    self.wheel_radius.is_empty(),
                    "--wheel-radius: there are no readings of wheels; a folder has them in mav0/wheels0/data.csv, a bag in the topic \
                     that --wheel-topic names"
                );
                return Ok(None);
            }
        };
        if given.is_none() {
            tracing::warn!("the recording has {lacks}");
        }
        Ok(given)
    }

    /// The wheels that stand for a base whose velocity is measured.
    fn of_base_velocities(&self, settled: Option<WheelConfig>) -> Result<Option<WheelConfig>> {
        ensure!(
            self.wheel_radius.is_empty(),
            "--wheel-radius: the topic has velocities of the base (nav_msgs/Odometry), which need no radius: leave it and --wheel-track out"
        );
        let Some(position_m) = self.base_position()? else { return Ok(settled) };
        let stated =
            settled.unwrap_or_else(|| wheel_config(&WheelSensor::of_base_velocity(Pose::identity())));
        Ok(Some(with_base_at(stated, position_m)))
    }

    /// Names the topic and the joints of the wheels in a recording.
    pub fn name_topic(&self, files: &mut CalibrationFiles) {
        files.wheel_topic.clone_from(&self.wheel_topic);
        files.wheel_joints = self.joints();
    }

    /// The joints of the left and the right wheel.
    pub fn joints(&self) -> Option<[String; 2]> {
        self.wheel_joints.clone().try_into().ok()
    }

    /// `--base-in-imu`.
    fn base_position(&self) -> Result<Option<[f64; 3]>> {
        match *self.base_in_imu.as_slice() {
            [] => Ok(None),
            [x, y, z] => Ok(Some([x, y, z])),
            _ => bail!("--base-in-imu takes three numbers separated by commas, in metres"),
        }
    }

    /// What the switches state, on top of the settings.
    fn given(&self, settled: Option<WheelConfig>) -> Result<Option<WheelConfig>> {
        ensure!(self.wheel_radius.len() <= 2, "--wheel-radius takes one number, or two separated by a comma");
        let wheels = match (self.wheel_radius.as_slice(), self.wheel_track, settled) {
            ([left, rest @ ..], Some(track), settled) => {
                let mut wheels = settled.unwrap_or_else(|| WheelConfig::new(*left, track));
                (wheels.radius_left_m, wheels.radius_right_m) =
                    (*left, rest.first().copied().unwrap_or(*left));
                wheels.track_m = track;
                wheels
            }
            (_, _, Some(settled)) => settled,
            _ if self.base_in_imu.is_empty() => return Ok(None),
            _ => bail!("--base-in-imu needs --wheel-radius and --wheel-track, or wheels0/sensor.yaml"),
        };
        Ok(Some(match self.base_position()? {
            Some(position_m) => with_base_at(wheels, position_m),
            None => wheels,
        }))
    }
}

fn with_base_at(mut wheels: WheelConfig, position_m: [f64; 3]) -> WheelConfig {
    wheels.base_position_m = position_m;
    wheels
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use nalgebra::Vector3;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        wheels: WheelArguments,
    }

    fn given(line: &str) -> WheelArguments {
        Line::try_parse_from(std::iter::once("robot").chain(line.split_whitespace())).unwrap().wheels
    }

    #[test]
    fn a_switch_overrides_the_calibration_and_wheels_need_readings() {
        let with = Contents { wheels: Some(WheelReadings::Speeds), ..Contents::default() };
        let mut stated = WheelConfig::new(0.2, 0.6);
        stated.noise.sigma_speed_rad_s = 0.1;
        assert_eq!(given("").wheels(Some(stated), with).unwrap(), Some(stated));
        assert_eq!(given("").wheels(Some(stated), Contents::default()).unwrap(), None);
        assert_eq!(given("--no-wheels").wheels(Some(stated), with).unwrap(), None);
        assert_eq!(given("").wheels(None, with).unwrap(), None, "the geometry is not known");
        let line = "--wheel-radius 0.1,0.11 --wheel-track 0.5 --base-in-imu -0.1,0,-0.2";
        let switched = given(line).wheels(Some(stated), with).unwrap().unwrap();
        assert_eq!((switched.radius_left_m, switched.radius_right_m, switched.track_m), (0.1, 0.11, 0.5));
        assert_eq!((switched.base_position_m, switched.noise), ([-0.1, 0.0, -0.2], stated.noise));
        assert!(given(line).wheels(None, Contents::default()).unwrap_err().to_string().contains("wheels0"));
        assert!(given("--base-in-imu 1,2,3").wheels(None, with).is_err());
        assert!(given("--base-in-imu 1,2").wheels(Some(stated), with).is_err());
        assert!(Line::try_parse_from(["robot", "--wheel-radius", "0.1"]).is_err());
    }

    #[test]
    fn velocities_of_a_base_need_its_pose_and_no_radius() {
        let velocities = Contents { wheels: Some(WheelReadings::BaseVelocities), ..Contents::default() };
        assert_eq!(given("").wheels(None, velocities).unwrap(), None);
        let placed = given("--base-in-imu -0.1,0,-0.2").wheels(None, velocities).unwrap().unwrap();
        assert_eq!((placed.radius_left_m, placed.track_m), (1.0, 1.0));
        assert_eq!(placed.imu_from_base().translation, Vector3::new(-0.1, 0.0, -0.2));
        assert_eq!(given("").wheels(Some(placed), velocities).unwrap(), Some(placed));
        let line = "--wheel-radius 0.1 --wheel-track 0.5";
        let error = given(line).wheels(Some(placed), velocities).unwrap_err().to_string();
        assert!(error.contains("need no radius"), "{error}");
    }
}
