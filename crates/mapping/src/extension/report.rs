//! Statistics of an extension.

use std::collections::BTreeMap;

use protocol::KeyframeId;
use serde::Serialize;

/// Statistics of a run of [`crate::extend_map`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExtensionReport {
    /// Keyframes of the recording.
    pub new_keyframes: usize,
    /// The camera of each of them, by its id in the map: the first one of a stereo pair, or a single one.
    #[serde(skip)]
    pub cameras: BTreeMap<KeyframeId, usize>,
    /// Images of the recording that could not be read and were left out, with the reason.
    pub unreadable_images: Vec<String>,
    /// Loops within the recording.
    pub loops: usize,
    /// Factor on the stated noise of the IMU by which its readings fit the images.
    pub imu_noise_scale: f64,
    /// Standard deviation of a pixel of the recording, as given or as estimated (px).
    pub sigma_px: f64,
    /// Keyframes of the map before.
    pub stored_keyframes: usize,
    /// Keyframes of the recording that show a place of the map.
    pub places: usize,
    /// Those of them that agree with each other and with the adjusted trajectory.
    pub agreeing_places: usize,
    /// Keyframes of the recording that show a place of the map that looks like no other one.
    pub places_told_apart: usize,
    /// Those of them that agree.
    pub agreeing_told_apart: usize,
    /// Part of the map's views that another place of it explains as well.
    pub repeating: f64,
    /// Keyframes of the map that these places tie to the recording; all others follow by their correlations with these.
    pub tied_keyframes: usize,
    /// How far the map moves the recording's keyframes relative to each other, squared, in units of what is to be expected: chi-square
    /// distributed with `map_freedom` degrees of freedom where recording and map are as certain as they state.
    pub map_chi_square: f64,
    /// Degrees of freedom of `map_chi_square`.
    pub map_freedom: f64,
    /// Landmarks of the map that the recording sees again.
    pub landmarks_seen_again: usize,
    /// Observations of them.
    pub observations_of_them: usize,
    /// Rotation of the map's keyframes by the extension, root mean square per axis (deg).
    pub moved_deg: f64,
    /// The same for their positions (m).
    pub moved_m: f64,
    /// Standard deviation of the map's positions before, root mean square per axis (m).
    pub sigma_before_m: f64,
    /// ... and after.
    pub sigma_after_m: f64,
    /// Keyframes afterwards.
    pub keyframes: usize,
    /// Landmarks afterwards.
    pub landmarks: usize,
    /// Time taken (s).
    pub seconds: f64,
}
