//! Which calibration files of Kalibr belong to a recording.

use crate::pairing::PAIR_TOLERANCE_NS;
use crate::{ImuUnits, SequenceError};
use calibration::kalibr::{is_camera_chain, is_imu, is_kimera_left, is_rig};
use geometry::Geodetic;
use std::path::{Path, PathBuf};
use types::{BaseKind, Encoder};

/// Larger YAML files are no calibrations, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Folders of a recording that are searched, in this order; the first one with a calibration counts. TUM-VI has `dso`.
const FOLDERS: [&str; 3] = ["", "mav0", "dso"];

/// What a recording does not say of itself: calibration files that replace its own, which topics of a bag are meant, and
/// which images make a stereo pair.
///
/// For a folder in the EuRoC layout the files are Kalibr's. For a bag, `cameras` may also be such a folder, of which only the
/// calibration is read, and Kalibr's camera chain may leave `intrinsics` out where the bag has the cameras' `CameraInfo`.
///
/// ```
/// let mut files = sensors::CalibrationFiles::default();
/// files.cameras = Some("camchain-imucam.yaml".into());
/// assert!(files.imu.is_none()); // as the recording states it
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct CalibrationFiles {
    /// `camchain-imucam.yaml`; for a bag also the folder of a calibration.
    pub cameras: Option<PathBuf>,
    /// `imu.yaml`.
    pub imu: Option<PathBuf>,
    /// The topic of the IMU in a bag, or of its gyroscope; without it the only one of its type.
    pub imu_topic: Option<String>,
    /// The topic of the accelerometer in a bag, where it is not that of the gyroscope; without it the only one without
    /// angular velocities.
    pub accelerometer_topic: Option<String>,
    /// The topic of the wheels in a bag; without it they are not read.
    pub wheel_topic: Option<String>,
    /// The topic of GNSS in a bag (`sensor_msgs/NavSatFix`); without it it is not read.
    pub gnss_topic: Option<String>,
    /// Origin of the frame that its positions are turned to.
    pub gnss_origin: Option<Geodetic>,
    /// The joints of the wheels in `sensor_msgs/JointState`, in the order of [`BaseKind::columns`]; without them those that are named so.
    pub wheel_joints: Vec<String>,
    /// What the base is; without it as a folder's `sensor.yaml` says, else a differential drive.
    pub wheel_base: Option<BaseKind>,
    /// The encoders of the wheels, where the recording has counts of them and does not say so.
    pub wheel_encoder: Option<Encoder>,
    /// The topics of camera 0 and camera 1 in a bag; without them those of their type, in order of their names.
    pub camera_topics: Vec<String>,
    /// Largest difference between the stamps of the images of a stereo pair, nanoseconds; without it
    /// [`PAIR_TOLERANCE_NS`].
    pub pair_tolerance_ns: Option<i64>,
    /// Units of the IMU's readings.
    pub imu_units: ImuUnits,
}

impl CalibrationFiles {
    /// The topics that are named.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        let single = [&self.imu_topic, &self.accelerometer_topic, &self.wheel_topic, &self.gnss_topic];
        single.into_iter().flatten().chain(&self.camera_topics).map(String::as_str)
    }

    /// The largest difference between the stamps of the images of a pair, nanoseconds.
    pub(crate) fn pair_tolerance_ns(&self) -> i64 {
        self.pair_tolerance_ns.unwrap_or(PAIR_TOLERANCE_NS)
    }

    /// The files that hold for a recording: these, and for those that are not given and have no `sensor.yaml`, the ones
    /// in its folder, recognized by their content.
    ///
    /// # Errors
    /// [`SequenceError::Calibration`]: several files in the folder could be meant.
    pub(crate) fn completed(&self, root: &Path) -> Result<Self, SequenceError> {
        let mut files = self.clone();
        let (camera, imu) = (root.join("mav0/cam0/sensor.yaml"), root.join("mav0/imu0/sensor.yaml"));
        let given = files.cameras.clone().filter(|path| path.is_file());
        if files.cameras.is_none() {
            files.cameras = unless_there(&camera, find(root, is_cameras, "--calibration")?, "--calibration");
        }
        if files.imu.is_none() {
            // The IMU may be in the file of the cameras.
            files.imu =
                given.clone().filter(|path| is_imu(&::files::read_to_string(path).unwrap_or_default()));
        }
        if files.imu.is_none() {
            files.imu = unless_there(&imu, find(root, is_imu, "--imu-calibration")?, "--imu-calibration");
        }
        if let (None, Some(beside)) = (&files.imu, given.as_deref().and_then(Path::parent))
            && !imu.exists()
        {
            files.imu = find(beside, is_imu, "--imu-calibration")?;
        }
        Ok(files)
    }
}

/// Whether a text has the cameras of a recording.
fn is_cameras(text: &str) -> bool {
    is_camera_chain(text) || is_kimera_left(text) || is_rig(text)
}

/// The found file, unless the recording has a `sensor.yaml`, which comes first.
fn unless_there(sensor_yaml: &Path, found: Option<PathBuf>, switch: &str) -> Option<PathBuf> {
    if !sensor_yaml.exists() {
        return found;
    }
    if let Some(found) = found {
        tracing::warn!(
            "{} is used, and {} is not: give it with {switch}, or remove the sensor.yaml files",
            sensor_yaml.display(),
            found.display()
        );
    }
    None
}

/// The only file of a kind in a recording's folder. Among camera chains, one with the IMU comes first.
fn find(root: &Path, is_kind: fn(&str) -> bool, switch: &str) -> Result<Option<PathBuf>, SequenceError> {
    for folder in FOLDERS {
        let mut found = yaml_files(&root.join(folder));
        found.retain(|(_, text)| is_kind(text));
        let on_imu = |text: &str| ["T_cam_imu", "T_imu_cam"].iter().any(|entry| text.contains(entry));
        if found.iter().any(|(_, text)| on_imu(text)) {
            found.retain(|(_, text)| on_imu(text));
        }
        match found.as_slice() {
            [] => {}
            [(path, _)] => return Ok(Some(path.clone())),
            [(path, _), (other, _), ..] => {
                let problem =
                    format!("{} could be meant as well: say which with {switch} FILE", other.display());
                return Err(SequenceError::calibration(path, problem));
            }
        }
    }
    Ok(None)
}

/// The folder of a file that is named without one is the current one.
fn named(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

/// The YAML files of a folder in order of their names, with their text; what cannot be read is left out.
fn yaml_files(folder: &Path) -> Vec<(PathBuf, String)> {
    let Ok(entries) = std::fs::read_dir(named(folder)) else { return Vec::new() };
    let is_yaml = |path: &PathBuf| {
        let extension = path.extension().unwrap_or_default();
        extension == "yaml" || extension == "yml" || extension == "json"
    };
    let mut paths: Vec<PathBuf> =
        entries.filter_map(Result::ok).map(|entry| entry.path()).filter(is_yaml).collect();
    paths.retain(|path| path.metadata().is_ok_and(|metadata| metadata.len() <= MAX_BYTES));
    paths.sort();
    let read = |path: PathBuf| ::files::read_to_string(&path).ok().map(|text| (path, text));
    paths.into_iter().filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_a_file_without_one_is_the_current_one() {
        assert_eq!(Path::new("camchain-imucam.yaml").parent().map(named), Some(Path::new(".")));
        assert_eq!(named(Path::new("robot")), Path::new("robot"));
    }
}
