//! Settings of place recognition.

/// Settings of place recognition and geometric verification.
///
/// The defaults are loose on purpose: a server rejects only the impossible, and ranks the rest. Landmarks of recorded
/// maps are off by decimetres (correct matches of the `yq_real` recording reproject with a median of 9 px at a focal
/// length of 855 px), and the robot has its own, tighter gates.
///
/// # Example
/// ```
/// let mut options = recognition::RecognitionOptions::default();
/// options.candidates = 20;
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecognitionOptions {
    /// How many of the keyframes with the most votes are matched feature by feature, and, where none of these tells the place, how
    /// many of other places.
    pub candidates: usize,
    /// Fewest query features that must vote for a keyframe to make it a candidate.
    pub min_votes: usize,
    /// Largest reprojection error of an inlier, as an angle (rad); times the focal length it is a pixel threshold.
    /// One degree: 15 px at a focal length of 855 px.
    pub inlier_angle: f64,
    /// Fewest inliers of a verified keyframe.
    pub min_inliers: usize,
    /// Fewest inliers of a pose that is returned to a client without an estimator, which has no gate of its own. XFeat in
    /// darkened images of V1_01: the one pose wrong by more than 0.5 m had 9; with 12 it is rejected, and no correct one
    /// is.
    pub min_fix_inliers: usize,
    /// Least logarithm of the odds that an image without a prior is of the place that explains it best, and not of a picture
    /// that repeats, see [`Hypothesis::log_odds`](crate::Hypothesis::log_odds). Below, the query is ambiguous.
    pub min_log_odds: f64,
    /// The same of a pose that is returned to a client without an estimator.
    pub min_fix_log_odds: f64,
    /// Standard deviation of a query pixel (px).
    pub sigma_query_px: f64,
    /// RANSAC samples at most.
    pub max_iterations: usize,
    /// Probability with which RANSAC finds the pose if one exists.
    pub confidence: f64,
    /// Seed of RANSAC: the same query always has the same answer.
    pub seed: u64,
    /// Largest standard deviation of the rotation (rad) of a verified pose.
    pub max_sigma_theta: f64,
    /// Largest standard deviation of the position of a verified pose, as a part of the inliers' median distance.
    pub max_relative_sigma_p: f64,
    /// Rotation error (rad, one standard deviation) that two verified poses may have beyond their covariances.
    pub tolerance_theta: f64,
    /// Position error (m, one standard deviation) that two verified poses may have beyond their covariances.
    pub tolerance_p: f64,
    /// Two places of which the weaker has at least this part of the support of the stronger are ambiguous, unless it is less likely
    /// than the other by the odds of `min_fix_log_odds`.
    pub ambiguity_ratio: f64,
    /// Fewest matched landmarks that a keyframe must observe to be sent as covisible.
    pub min_covisible: usize,
    /// Most keyframes in an answer, whatever the query asks for.
    pub max_keyframes: usize,
}

impl Default for RecognitionOptions {
    fn default() -> RecognitionOptions {
        RecognitionOptions {
            candidates: 10,
            min_votes: 4,
            inlier_angle: 0.0175,
            min_inliers: 8,
            min_fix_inliers: 12,
            min_log_odds: -1.0,
            // Odds of 7, as those of a robot's first pose.
            min_fix_log_odds: 1.946,
            sigma_query_px: 1.0,
            max_iterations: 500,
            confidence: 0.999,
            seed: 0x6d61_7020_7365_7276,
            max_sigma_theta: 0.1,
            max_relative_sigma_p: 0.2,
            tolerance_theta: 0.02,
            tolerance_p: 0.1,
            ambiguity_ratio: 0.7,
            min_covisible: 4,
            max_keyframes: 32,
        }
    }
}
