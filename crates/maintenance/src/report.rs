//! What became of a session.

use serde::Serialize;

use crate::rates::DetectionRates;

/// What a session did to the map.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct SessionReport {
    /// Keyframes of the session that the map keeps, of ...
    pub kept_keyframes: usize,
    /// ... all that it has.
    pub session_keyframes: usize,
    /// Keyframes of the session that show a place of the map, and agree with each other and with the trajectory.
    pub agreeing_places: usize,
    /// How far the map moved the session's keyframes relative to each other, squared, over what both state: 1 where all is as stated.
    pub map_ratio: f64,
    /// Its pixel noise (px).
    pub sigma_px: f64,
    /// Landmarks of the map that the session saw.
    pub seen: usize,
    /// Landmarks that it expected and did not see.
    pub missed: usize,
    /// How likely it sees a landmark that is there, expected by 1, 2, 3, and more of its keyframes.
    pub detection_rates: DetectionRates,
    /// Where landmarks were taken out because they are gone: positions in G (m).
    pub gone_m: Vec<[f64; 3]>,
    /// Landmarks that were taken out because their place has enough of them.
    pub surplus_landmarks: usize,
    /// Keyframes of the map that were taken out.
    pub removed: RemovedKeyframes,
    /// Keyframes of the map afterwards.
    pub keyframes: usize,
    /// Landmarks of the map afterwards.
    pub landmarks: usize,
}

/// Why keyframes of the map were taken out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RemovedKeyframes {
    /// Too little of what they show is still there.
    pub gone: usize,
    /// Others show their place as well, and more of what is there.
    pub replaced: usize,
    /// Nobody has seen their appearance for long, while another one of their place was seen.
    pub unused: usize,
}
