//! Switches of the wheels.

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use estimator::{WheelBase, WheelConfig};
use geometry::Pose;
use robot::wheel_config;
use sensors::{BaseKind, CalibrationFiles, Contents, Encoder, WheelReadings, WheelSensor};

/// Heading of these switches in `--help`.
const HEADING: &str = "Wheels";

/// Bits of a counter whose width is not stated.
const COUNTER_BITS: u32 = 32;

/// What the base is, and the geometry of its wheels.
#[derive(Args, Clone, Debug, Default)]
pub struct WheelArguments {
    /// What the base is [default: that of wheels0/sensor.yaml, else differential]
    ///
    /// differential: two driven wheels on one axis. ackermann: a car. mecanum: four wheels with rollers. omni3, omni4: omni wheels around the
    /// base, the first one on its x axis. For nav_msgs/Odometry the last three say that the base moves sideways.
    #[arg(long, value_name = "KIND", value_parser = base_kind, help_heading = HEADING)]
    pub wheel_base: Option<BaseKind>,
    /// Topic of the wheels: sensor_msgs/JointState with their speeds or positions, or nav_msgs/Odometry, of which the velocity is used: in a bag, or
    /// with --source ros2 [default: none]
    ///
    /// With --source ros2 it is of sensor_msgs/JointState where --wheel-radius or --wheel-joints is given.
    /// The pose of nav_msgs/Odometry is not used, and its velocity must be that of the encoders: not one that cameras or an IMU have
    /// improved. Its scale and turns are estimated, from 2 %.
    #[arg(long, value_name = "TOPIC", help_heading = HEADING)]
    pub wheel_topic: Option<String>,
    /// Joints of the wheels in sensor_msgs/JointState, as the base has them: LEFT,RIGHT; DRIVE,STEERING; FRONT_LEFT,FRONT_RIGHT,REAR_LEFT,REAR_RIGHT;
    /// omni wheels counterclockwise [default: those named wheel, and left or right, front or rear, steer; several of a side count by
    /// their mean]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "wheel_topic", help_heading = HEADING)]
    pub wheel_joints: Vec<String>,
    /// Counts of an encoder in a revolution of its wheel, and the bits of its counter, where counts come in place of speeds [default: as
    /// wheels0/sensor.yaml says; 32 bits]
    #[arg(long, value_name = "N[,BITS]", value_delimiter = ',', help_heading = HEADING)]
    pub wheel_counts: Vec<f64>,
    /// Radius of the wheels, metres; several separated by commas are those of the wheels in their order [default: that of
    /// wheels0/sensor.yaml]
    ///
    /// With --wheel-track it makes the speeds in mav0/wheels0/data.csv (stamp, left, right; ns, rad/s) odometry: one camera
    /// that drives straight knows its scale, and a slip is left out. Radii, track, the pose of the base and the time offset
    /// are estimated during the run, from 2 %, 2 %, 1 degree, 2 cm and 5 ms; the result is in summary.json. Noise and these
    /// standard deviations are in the settings file, under wheels.
    #[arg(long, value_name = "M[,M..]", value_delimiter = ',', requires = "wheel_track", help_heading = HEADING)]
    pub wheel_radius: Vec<f64>,
    /// Distance between the wheels, metres; of an ackermann base that between its axles, of mecanum wheels half of that between the axles and
    /// half of that between the sides together, of omni wheels that from the middle
    #[arg(long, value_name = "M", requires = "wheel_radius", help_heading = HEADING)]
    pub wheel_track: Option<f64>,
    /// Where the middle of the wheels (of an ackermann base, of the axle that does not steer) on the floor is in the frame of the IMU, metres; the base looks along x of the IMU
    /// [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true, help_heading = HEADING)]
    pub base_in_imu: Vec<f64>,
    /// Do not use the wheels
    #[arg(long, conflicts_with_all = ["wheel_base", "wheel_counts", "wheel_radius", "base_in_imu"], help_heading = HEADING)]
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
                let is_asked_for = self.wheel_base.is_some()
                    || !(self.wheel_radius.is_empty()
                        && self.wheel_counts.is_empty()
                        && self.base_in_imu.is_empty());
                ensure!(
                    !is_asked_for,
                    "--wheel-radius, --wheel-base, --wheel-counts, --base-in-imu: there are no readings of wheels; a folder has \
                     them in mav0/wheels0/data.csv, a bag or ROS 2 in the topic that --wheel-topic names"
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
        let kind = self.wheel_base.unwrap_or_default();
        let stated =
            settled.unwrap_or_else(|| wheel_config(&WheelSensor::of_base_velocity(kind, Pose::identity())));
        Ok(Some(with_base_at(stated, position_m)))
    }

    /// Names the topic and the joints of the wheels in a recording, the base and its encoders.
    ///
    /// # Errors
    /// Joints or counts that are none of such a base.
    pub fn name_topic(&self, files: &mut CalibrationFiles) -> Result<()> {
        self.check_joints(self.wheel_base.unwrap_or_default())?;
        files.wheel_topic.clone_from(&self.wheel_topic);
        files.wheel_joints.clone_from(&self.wheel_joints);
        files.wheel_base = self.wheel_base;
        files.wheel_encoder = self.encoder()?;
        Ok(())
    }

    /// Checks that the joints are as many as such a base has, where they are named.
    pub(crate) fn check_joints(&self, kind: BaseKind) -> Result<()> {
        let joints = self.wheel_joints.len();
        ensure!(
            joints == 0 || joints == kind.columns().len(),
            "--wheel-joints names {joints} joints, but a {kind} base has {}: {}",
            kind.columns().len(),
            kind.columns().join(", ")
        );
        Ok(())
    }

    /// Whether a robot is told what its wheels are: by the switches, by its calibration or by the estimator's settings, which have it.
    pub fn is_expected(&self, settled: Option<&WheelConfig>) -> bool {
        !self.no_wheels && (settled.is_some() || !self.wheel_radius.is_empty())
    }

    /// The encoders that the switches state.
    ///
    /// # Errors
    /// They cannot be those of an encoder.
    pub fn encoder(&self) -> Result<Option<Encoder>> {
        let (counts, bits) = match *self.wheel_counts.as_slice() {
            [] => return Ok(None),
            [counts] => (counts, f64::from(COUNTER_BITS)),
            [counts, bits, ..] => (counts, bits),
        };
        Encoder::new(counts, bits as u32).map(Some).context("--wheel-counts")
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
        let stated = settled.map(|settled| settled.base.kind());
        let kind = self.wheel_base.or(stated).unwrap_or_default();
        let mut wheels = match (self.wheel_radius.as_slice(), self.wheel_track, settled) {
            (radii @ [first, ..], Some(track), settled) => {
                let mut base = WheelBase::new(kind, *first, track);
                let count = kind.wheels();
                ensure!(
                    base.set_radii_m(radii),
                    "--wheel-radius takes one number, or {count} of a {kind} base"
                );
                let mut wheels = settled.unwrap_or_else(|| WheelConfig::new(base));
                wheels.base = base;
                wheels
            }
            (_, _, Some(settled)) if settled.base.kind() == kind => settled,
            (_, _, Some(_)) => {
                bail!(
                    "--wheel-base {kind} needs --wheel-radius and --wheel-track: the settings are those of another base"
                )
            }
            _ if self.base_in_imu.is_empty() => return Ok(None),
            _ => bail!("--base-in-imu needs --wheel-radius and --wheel-track, or wheels0/sensor.yaml"),
        };
        if let Some(encoder) = self.encoder()? {
            wheels.noise.sigma_angle_rad = encoder.sigma_angle_rad();
        }
        Ok(Some(match self.base_position()? {
            Some(position_m) => with_base_at(wheels, position_m),
            None => wheels,
        }))
    }
}

/// A kind of base by its name.
fn base_kind(name: &str) -> Result<BaseKind, String> {
    let names = || BaseKind::ALL.map(BaseKind::name).join(", ");
    BaseKind::named(name).ok_or_else(|| format!("it is one of {}", names()))
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
        let mut stated = WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.2, 0.6));
        stated.noise.sigma_speed_rad_s = 0.1;
        assert_eq!(given("").wheels(Some(stated), with).unwrap(), Some(stated));
        assert_eq!(given("").wheels(Some(stated), Contents::default()).unwrap(), None);
        assert_eq!(given("--no-wheels").wheels(Some(stated), with).unwrap(), None);
        assert_eq!(given("").wheels(None, with).unwrap(), None, "the geometry is not known");
        let line = "--wheel-radius 0.1,0.11 --wheel-track 0.5 --base-in-imu -0.1,0,-0.2";
        let switched = given(line).wheels(Some(stated), with).unwrap().unwrap();
        assert_eq!(switched.base.parameters(), [0.1, 0.11, 0.5]);
        assert_eq!((switched.base_position_m, switched.noise), ([-0.1, 0.0, -0.2], stated.noise));
        assert!(given(line).wheels(None, Contents::default()).unwrap_err().to_string().contains("wheels0"));
        assert!(given("--base-in-imu 1,2,3").wheels(None, with).is_err());
        assert!(given("--base-in-imu 1,2").wheels(Some(stated), with).is_err());
        assert!(Line::try_parse_from(["robot", "--wheel-radius", "0.1"]).is_err());
    }

    #[test]
    fn other_bases_and_encoders_are_named() {
        let with = Contents { wheels: Some(WheelReadings::Speeds), ..Contents::default() };
        let line = "--wheel-base ackermann --wheel-radius 0.3 --wheel-track 2.6 --wheel-counts 4096,16";
        let car = given(line).wheels(None, with).unwrap().unwrap();
        assert_eq!(car.base, WheelBase::new(BaseKind::Ackermann, 0.3, 2.6));
        assert!((car.noise.sigma_angle_rad - 4.43e-4).abs() < 1e-6);
        let mut files = CalibrationFiles::default();
        given(line).name_topic(&mut files).unwrap();
        assert_eq!(files.wheel_encoder, Some(Encoder::new(4096.0, 16).unwrap()));
        let stated = Some(WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.2, 0.6)));
        assert!(given("--wheel-base mecanum").wheels(stated, with).is_err());
        let radii = "--wheel-base mecanum --wheel-radius 0.1,0.2,0.3 --wheel-track 0.4";
        let error = given(radii).wheels(None, with).unwrap_err().to_string();
        assert!(error.contains("or 4 of a mecanum base"), "{error}");
        let joints = "--wheel-topic /joints --wheel-joints a,b --wheel-base mecanum";
        assert!(given(joints).name_topic(&mut files).is_err());
        assert!(given("--wheel-counts 0").name_topic(&mut files).is_err());
        assert!(Line::try_parse_from(["robot", "--wheel-base", "tracked"]).is_err());
    }

    #[test]
    fn velocities_of_a_base_need_its_pose_and_no_radius() {
        let velocities = Contents { wheels: Some(WheelReadings::BaseVelocities), ..Contents::default() };
        assert_eq!(given("").wheels(None, velocities).unwrap(), None);
        let placed = given("--base-in-imu -0.1,0,-0.2").wheels(None, velocities).unwrap().unwrap();
        assert_eq!(placed.base, WheelBase::new(BaseKind::Differential, 1.0, 1.0));
        let sideways = given("--wheel-base omni3 --base-in-imu 0,0,0").wheels(None, velocities).unwrap();
        assert_eq!(sideways.unwrap().base, WheelBase::new(BaseKind::Mecanum, 1.0, 1.0));
        assert_eq!(placed.imu_from_base().translation, Vector3::new(-0.1, 0.0, -0.2));
        assert_eq!(given("").wheels(Some(placed), velocities).unwrap(), Some(placed));
        let line = "--wheel-radius 0.1 --wheel-track 0.5";
        let error = given(line).wheels(Some(placed), velocities).unwrap_err().to_string();
        assert!(error.contains("need no radius"), "{error}");
    }
}
