//! Where the IMU is on the robot.

use geometry::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use std::str::FromStr;

/// The pose of the IMU in the robot's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuInBaseLink(pub Pose);

impl ImuInBaseLink {
    /// The other way round.
    pub fn imu_from_base(self) -> Pose {
        self.0.inverse()
    }
}

impl FromStr for ImuInBaseLink {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, z, roll, pitch, yaw]) if numbers.iter().flatten().all(|number| number.is_finite()) => {
                let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                Ok(Self(Pose::new(rotation, Vector3::new(x, y, z))))
            }
            _ => Err("give six numbers: x,y,z,roll,pitch,yaw in metres and radians".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_imu_in_base_link_is_read_as_in_urdf() {
        let ImuInBaseLink(pose) = "0.1,-0.2,0.3,0,0,1.5707963267948966".parse().unwrap();
        let in_base = pose.transform(&Vector3::new(1.0, 0.0, 0.0));
        assert!((in_base - Vector3::new(0.1, 0.8, 0.3)).norm() < 1e-12, "{in_base}");
        for wrong in ["", "1,2,3", "0,0,0,0,0,x", "0,0,0,0,0,nan", "0,0,0,0,0,0,0"] {
            assert!(wrong.parse::<ImuInBaseLink>().is_err(), "{wrong}");
        }
    }
}
