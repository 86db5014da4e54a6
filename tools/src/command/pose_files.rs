//! Files of poses and positions that a map is built from.

use anyhow::{Context as _, Result, bail};
use evaluation::trajectory::{PoseFormat, StampedPose, StateKind, read_any_with};
use geometry::covariance_check::check_covariance;
use mapping::PosePriors;
use nalgebra::{Matrix6, Vector3};
use sensors::{QuaternionOrder, ReferencePose, read_reference_positions};
use std::path::{Path, PathBuf};

/// The order of a quaternion's columns, where a file does not tell it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum QuaternionArgument {
    /// The scalar part first, as EuRoC
    Wxyz,
    /// The scalar part last, as TUM and ROS
    Xyzw,
}

impl From<QuaternionArgument> for QuaternionOrder {
    fn from(argument: QuaternionArgument) -> Self {
        match argument {
            QuaternionArgument::Wxyz => Self::WFirst,
            QuaternionArgument::Xyzw => Self::WLast,
        }
    }
}

/// Poses and positions that are known at some times.
#[derive(Clone, Debug, clap::Args)]
pub struct PriorArguments {
    /// Positions that are known at some times, in the map's frame (z up)
    #[arg(long, value_name = "FILE", conflicts_with = "poses")]
    pub position_priors: Option<PathBuf>,
    /// The point that --position-priors are of, in the frame of the IMU, m
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_vector, allow_hyphen_values = true, requires = "position_priors")]
    pub lever_arm: Option<Vector3<f64>>,
    /// Errors of positions that are this close in time are alike, s; for example 60 for GNSS without corrections
    /// [default: 0, independent errors]
    #[arg(long, value_name = "SECONDS", requires = "position_priors")]
    pub position_correlation: Option<f64>,
    /// Poses of the IMU that are known at some times, in the map's frame (z up), in any of the formats of --poses
    #[arg(long, value_name = "FILE", conflicts_with = "poses")]
    pub pose_priors: Option<PathBuf>,
    /// Order of the quaternions in a file of poses whose header does not name its columns
    #[arg(long, value_name = "ORDER", value_enum)]
    pub quaternion: Option<QuaternionArgument>,
}

impl PriorArguments {
    /// Whether there are some.
    pub(super) fn are_given(&self) -> bool {
        self.position_priors.is_some() || self.pose_priors.is_some()
    }

    /// Reads the files.
    ///
    /// # Arguments
    /// * `sigma_theta`, `sigma_p`: standard deviations of those that state none (rad, m).
    ///
    /// # Errors
    /// A file that cannot be read, or without standard deviations.
    pub(super) fn read(&self, sigma_theta: Option<f64>, sigma_p: Option<f64>) -> Result<PosePriors> {
        let mut priors = PosePriors::default();
        if let Some(path) = &self.position_priors {
            priors.positions = read_reference_positions(path, sigma_p).with_context(|| {
                let known =
                    if sigma_p.is_some() { "" } else { "; --sigma-p M states the sigma of all positions" };
                format!("--position-priors{known}")
            })?;
            priors.lever_arm = self.lever_arm.unwrap_or_default();
            let seconds = self.position_correlation.unwrap_or(0.0);
            if !(seconds.is_finite() && seconds >= 0.0) {
                bail!("--position-correlation is {seconds}; it must be zero or more seconds");
            }
            priors.correlate_positions(seconds);
        }
        if let Some(path) = &self.pose_priors {
            priors.poses = self.poses_of_file(path, sigma_theta, sigma_p)?;
        }
        Ok(priors)
    }

    /// Poses of any format; the sigmas are those of the switches, else of the file where it has some.
    ///
    /// # Errors
    /// A file that cannot be read, or without standard deviations or times.
    pub(super) fn poses_of_file(
        &self,
        path: &Path,
        sigma_theta: Option<f64>,
        sigma_p: Option<f64>,
    ) -> Result<Vec<ReferencePose>> {
        poses_of_file(path, self.quaternion.map(QuaternionOrder::from), sigma_theta, sigma_p)
    }
}

fn parse_vector(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, z]) if [x, y, z].iter().all(|value| value.is_finite()) => Ok(Vector3::new(*x, *y, *z)),
        _ => Err("three numbers are needed, for example 0.1,0,0.4".to_owned()),
    }
}

fn poses_of_file(
    path: &Path,
    quaternion: Option<QuaternionOrder>,
    sigma_theta: Option<f64>,
    sigma_p: Option<f64>,
) -> Result<Vec<ReferencePose>> {
    let states = [StateKind::GlobalFromImu, StateKind::LocalFromImu];
    let file = read_any_with(path, &states, quaternion)?;
    let repeated = match file.repeated_rows {
        0 => String::new(),
        rows => format!(", without {rows} rows that repeat the one before"),
    };
    eprintln!("{}: {} poses, read as {}{repeated}", path.display(), file.poses.len(), file.format);
    if file.format == PoseFormat::Kitti {
        bail!(
            "{}: KITTI's poses have no times, and those of its left camera are none of the IMU: give a TUM file of the IMU's \
             poses (t x y z qx qy qz qw)",
            path.display()
        );
    }
    let Some(covariances) = file.covariances else {
        let (Some(sigma_theta), Some(sigma_p)) = (sigma_theta, sigma_p) else {
            bail!(
                "{} ({}) states no standard deviations: state those of its poses with --sigma-theta RAD and --sigma-p M",
                path.display(),
                file.format
            );
        };
        let reference =
            |row: &StampedPose| ReferencePose::isotropic(row.stamp_ns, row.pose, sigma_theta, sigma_p);
        return Ok(file.poses.iter().map(reference).collect());
    };
    let reference = |(row, covariance): (&StampedPose, Matrix6<f64>)| {
        check_covariance(&covariance).with_context(|| {
            format!("{}: the covariance of the pose at {} ns", path.display(), row.stamp_ns)
        })?;
        let stated = ReferencePose { stamp_ns: row.stamp_ns, pose: row.pose, covariance };
        Ok(stated.with_sigmas(sigma_theta, sigma_p))
    };
    file.poses.iter().zip(covariances).map(reference).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use evaluation::trajectory::states::{self, StateRow};
    use geometry::Pose;
    use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};

    #[test]
    fn poses_of_a_tum_file_need_sigmas_and_those_of_a_run_have_covariances() {
        let folder = tempfile::tempdir().unwrap();
        let tum = folder.path().join("odometry.tum");
        std::fs::write(&tum, "10.5 1 2 3 0 0 0 1\n10.6 1 2 3 0 0 0 1\n").unwrap();
        let error = poses_of_file(&tum, None, None, None).unwrap_err().to_string();
        assert!(error.contains("--sigma-theta") && error.contains("TUM"), "{error}");
        let poses = poses_of_file(&tum, None, Some(0.02), Some(0.1)).unwrap();
        assert_eq!((poses.len(), poses[0].stamp_ns), (2, 10_500_000_000));
        assert_eq!(poses[1].covariance, isotropic_covariance(0.02, 0.1));

        let path = folder.path().join("states.csv");
        let mut covariance = isotropic_covariance(0.02, 0.1);
        (covariance[(0, 4)], covariance[(4, 0)]) = (1e-4, 1e-4);
        let row = StateRow {
            stamp_ns: 7,
            local_from_imu: PoseWithCovariance::new(Pose::identity(), covariance),
            global_from_local: None,
            global_from_imu: None,
        };
        states::write(&path, std::slice::from_ref(&row)).unwrap();
        let poses = poses_of_file(&path, None, None, None).unwrap();
        assert!((poses[0].covariance - covariance).amax() < 1e-12);
        // What is known better than the file states it.
        let wider = poses_of_file(&path, None, Some(0.05), Some(0.3)).unwrap();
        assert_eq!(wider[0].covariance, isotropic_covariance(0.05, 0.3));
        let positions = poses_of_file(&path, None, None, Some(0.3)).unwrap()[0].covariance;
        assert!((positions[(0, 0)] - 0.02_f64.powi(2)).abs() < 1e-12 && positions[(0, 4)] == 0.0);
        assert!((positions[(3, 3)] - 0.09).abs() < 1e-12);

        let mut indefinite = row;
        indefinite.local_from_imu.covariance[(3, 3)] = -1.0;
        states::write(&path, &[indefinite]).unwrap();
        let error = format!("{:#}", poses_of_file(&path, None, None, None).unwrap_err());
        assert!(error.contains("states.csv") && error.contains("7 ns"), "{error}");
    }
}
