//! The topics that the cameras of a chain were calibrated with.

use super::{CHAIN, CameraYaml, ChainYaml, is_camera_chain};
use crate::CalibrationError;
use crate::yaml::{parse, read_text};
use std::path::Path;

/// The last part of a topic's name that image_transport adds to the name of the uncompressed images.
pub const COMPRESSED: &str = "/compressed";

/// The topic of each camera of a chain, where the file states it.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn camera_topics(path: &Path) -> Result<Vec<Option<String>>, CalibrationError> {
    let text = read_text(path)?;
    if !is_camera_chain(&text) {
        return Ok(Vec::new());
    }
    let chain: ChainYaml = parse(path, CHAIN, &text)?;
    let topic = |camera: &CameraYaml| camera.rostopic.clone().filter(|topic| !topic.is_empty());
    Ok(chain.cameras().map(topic).collect())
}

/// Which camera of a chain each topic of images is: the one that was calibrated with it, else the one in its place.
///
/// # Arguments
/// * `names`: topics of the cameras, in order.
/// * `has_topic`: whether the recording has a topic of the camera with a name.
///
/// # Errors
/// [`CalibrationError`]: a camera is calibrated for a topic that is there, but another one is to be used with it.
pub fn chosen_cameras(
    chain: &Path,
    names: &[&str],
    has_topic: impl Fn(&str) -> bool,
) -> Result<Vec<usize>, CalibrationError> {
    let calibrated = camera_topics(chain)?;
    let is_of = |of: &Option<String>, name: &str| of.as_ref().is_some_and(|of| is_same_camera(of, name));
    let choose = |(place, name): (usize, &&str)| {
        if let Some(index) = calibrated.iter().position(|of| is_of(of, name)) {
            return Ok(index);
        }
        let Some(of) = calibrated.get(place).and_then(Option::as_ref) else { return Ok(place) };
        if has_topic(of) {
            let problem = format!(
                "cam{place} is calibrated for {of} (rostopic), which is there, but {name} is to be used with it: calibrate that \
                 camera, name the right topics with --camera-topic, or correct rostopic"
            );
            return Err(CalibrationError::entry(chain, problem));
        }
        tracing::warn!(
            "{}: cam{place} is calibrated for {of} (rostopic), which is not there, and is used for {name}: is it the same camera?",
            chain.display()
        );
        Ok(place)
    };
    names.iter().enumerate().map(choose).collect()
}

/// Whether two topics are of the same camera: with or without `/compressed`.
pub fn is_same_camera(a: &str, b: &str) -> bool {
    let plain = |name: &str| name.trim_start_matches('/').trim_end_matches(COMPRESSED).to_owned();
    plain(a) == plain(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_is_the_camera_that_was_calibrated_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camchain.yaml");
        std::fs::write(&path, "cam0:\n  rostopic: /left/image_raw\ncam1:\n  rostopic: /right/image_raw\n")
            .unwrap();
        let chosen = |names: &[&str], others: &[&str]| {
            chosen_cameras(&path, names, |of| names.iter().chain(others).any(|name| is_same_camera(name, of)))
        };
        assert_eq!(chosen(&["/right/image_raw", "/left/image_raw/compressed"], &[]).unwrap(), [1, 0]);
        assert_eq!(chosen(&["right/image_raw/compressed"], &[]).unwrap(), [1]);
        assert_eq!(chosen(&["/a", "/b"], &[]).unwrap(), [0, 1], "said, and used in their order");
        let error = chosen(&["/a"], &["/left/image_raw"]).unwrap_err().to_string();
        assert!(error.contains("/left/image_raw") && error.contains("/a"), "{error}");
    }
}
