//! Why a map cannot be built.

/// Why no map could be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A standard deviation of the poses is negative or not finite.
    #[error("the sigmas of the poses must be zero or positive, not {sigma}")]
    PoseSigma {
        /// The value (rad or m).
        sigma: f64,
    },
    /// The standard deviation of a pixel is not positive.
    #[error("the sigma of a pixel must be positive, not {sigma_px}")]
    PixelSigma {
        /// The value (px).
        sigma_px: f64,
    },
    /// [`crate::BuildOptions::min_observations`] is too small.
    #[error("a landmark needs at least two observations, not {min_observations}")]
    MinObservations {
        /// The value.
        min_observations: usize,
    },
    /// The recording has no features for place recognition.
    #[error(
        "{sequence} has no mav0/cam0/features.csv, or it is empty, and no extractor was asked for: a map is built from \
         features"
    )]
    NoFeatures {
        /// The recording.
        sequence: String,
    },
    /// The recording has no images.
    #[error("{sequence} has no images in mav0/cam0/data: copy them there, or build from a features.csv")]
    NoImages {
        /// The recording.
        sequence: String,
    },
    /// An image has another size than its camera.
    #[error(
        "{image} has {} x {} pixels, but the calibration of cam{camera} is for {} x {}: give the calibration of these \
         images, or scale resolution and intrinsics with them",
        size.0, size.1, calibrated.0, calibrated.1
    )]
    ImageSize {
        /// The file.
        image: String,
        /// Its columns and rows.
        size: (usize, usize),
        /// Columns and rows by the calibration.
        calibrated: (usize, usize),
        /// The camera, 0 or 1.
        camera: usize,
    },
    /// The image of a keyframe cannot be kept.
    #[error("{image} cannot be kept in the map: {source}")]
    Encoding {
        /// The file.
        image: String,
        /// What is wrong.
        source: vision::ImageError,
    },
    /// The extractor failed.
    #[error("{image}: {source}")]
    Extraction {
        /// The file.
        image: String,
        /// The reason.
        source: vision::ExtractError,
    },
    /// No image has both features and a reference pose.
    #[error(
        "no image has both features and a reference pose at its time ({images} images, {poses} poses, {in_time} images \
         between --from and --until; poses at most 0.11 s apart are interpolated): check that both are of one recording"
    )]
    NoCommonStamps {
        /// Images with features.
        images: usize,
        /// Reference poses.
        poses: usize,
        /// Images with features in the time range of the options.
        in_time: usize,
    },
    /// Descriptors cannot be compared.
    #[error("the descriptors cannot be matched: {0}")]
    Descriptors(#[from] vision::DescriptorError),
    /// No image with features has a pose.
    #[error("no image with features has a pose: the map would have no keyframe")]
    NoKeyframes,
    /// Odometry gave no poses.
    #[error(
        "the odometry gave no pose of an image with features ({states} poses): look at what `driftless run REC --mode odometry` \
         says of this recording, or give poses with --poses"
    )]
    NoOdometry {
        /// Number of poses.
        states: usize,
    },
    /// The camera did not move.
    #[error(
        "the camera moved by {moved_m:.2} m in {seconds:.0} s of odometry, too little for a second keyframe: a landmark needs two \
         places, so record while moving through the place, or set the distance of keyframes smaller"
    )]
    NoMotion {
        /// Largest distance from the first pose (m).
        moved_m: f64,
        /// Duration of the odometry (s).
        seconds: f64,
    },
    /// Parts of the recording that no image ties together.
    #[error(
        "the recording falls into pieces: at {at_s:.1} s nothing but the IMU ties its images together, so that what follows is \
         known to {sigma_deg:.0} deg and {sigma_m:.0} m only; record it again without such a gap, or so that it returns to \
         its beginning, or build a map of each piece (--until {at_s:.1}, --from {at_s:.1}) and join them with `driftless \
         merge-maps`"
    )]
    Pieces {
        /// Begin of the second piece (s from the first frame).
        at_s: f64,
        /// Standard deviation of its rotation relative to the first piece (deg).
        sigma_deg: f64,
        /// The same for its position (m).
        sigma_m: f64,
    },
    /// No pose prior lies in the time of the recording.
    #[error(
        "none of the {given} position and pose priors lies in the time of the odometry, {from_ns} to {until_ns} ns: are their \
         times on the clock of the recording, in nanoseconds?"
    )]
    PosePriorsOutside {
        /// Number of priors.
        given: usize,
        /// First pose of the odometry (ns).
        from_ns: i64,
        /// Last pose of the odometry (ns).
        until_ns: i64,
    },
    /// Position priors that do not determine yaw.
    #[error(
        "{positions} positions within {extent_m:.3} m, known to {sigma_m:.3} m, do not determine yaw: give positions further \
         apart, or a pose"
    )]
    YawUnknown {
        /// Number of positions.
        positions: usize,
        /// Largest horizontal distance from their mean (m).
        extent_m: f64,
        /// Their standard deviation along an axis (m).
        sigma_m: f64,
    },
    /// Pose priors that the recording contradicts.
    #[error(
        "{refused} of {used} position and pose priors contradict the recording by more than their sigmas allow: check that z \
         points up in their frame, their times, the lever arm, and that the sigmas are not too small"
    )]
    PosePriorsContradict {
        /// Those that contradict it.
        refused: usize,
        /// Those in the time of the recording.
        used: usize,
    },
    /// Reference poses that the gyroscope contradicts.
    #[error(
        "in {contradicted} of {used} turns the poses turn otherwise than the gyroscope (turns of {turn_deg:.0} deg, off by \
         {difference_deg:.0} deg): check that they are poses of the IMU (not of a camera, and not their inverse), the order of their \
         quaternion (by the file's header, or --quaternion), their times, and the unit of the gyroscope (rad/s)"
    )]
    ReferencesTurnOtherwise {
        /// Turns that differ.
        contradicted: usize,
        /// Turns that were compared.
        used: usize,
        /// Median of the turns by the gyroscope (deg).
        turn_deg: f64,
        /// Median of the differences (deg).
        difference_deg: f64,
    },
    /// Reference poses whose positions fit the accelerometer only on other axes.
    #[error(
        "the positions of the poses accelerate as the IMU did only when taken as {axes} (correlation {correlation_on_others:.2}, and \
         {correlation:.2} as they are): give positions and rotations in one right-handed frame"
    )]
    ReferencesOnOtherAxes {
        /// The axes that fit, as `(y, x, -z)`.
        axes: String,
        /// Correlation of the accelerations with the axes as given.
        correlation: f64,
        /// The same with the others.
        correlation_on_others: f64,
    },
    /// Reference poses whose positions have another scale than the accelerometer.
    #[error(
        "the positions of the poses accelerate {scale:.3} times as much as the IMU: check their unit (metres; a trajectory of one \
         camera has a scale of its own), and the unit of the accelerometer (m/s^2)"
    )]
    ReferencesOfOtherScale {
        /// Accelerations by the positions over those by the accelerometer.
        scale: f64,
    },
    /// Hardly any images show one place.
    #[error(
        "only {located} of {images} stereo pairs show a place that an earlier one shows, or the IMU does not cover them: images \
         this far apart must overlap"
    )]
    TooFewRegistered {
        /// Pairs of images.
        images: usize,
        /// Those whose pose is known.
        located: usize,
    },
    /// The trajectory of the images does not fit the readings of the IMU.
    #[error(
        "images and IMU contradict each other: together they give a gravity of {gravity:.2} m/s^2; check the extrinsics and \
         baseline of the cameras, the time offset between camera and IMU, and the units of the IMU"
    )]
    ContradictsImu {
        /// Magnitude of gravity (m/s^2).
        gravity: f64,
    },
    /// A COLMAP model has no scale.
    #[error(
        "the scale of the model is unknown: no two images are a stereo pair of the recording (names with the same time stamp \
         in cam0 and cam1), and its IMU gives it to {percent:.0} % only; give the metres in the model's unit of length with \
         --scale"
    )]
    ColmapScale {
        /// Standard deviation of the scale that the IMU gives (per cent).
        percent: f64,
    },
    /// An image has another size than its camera in a COLMAP model.
    #[error(
        "{image} has {} x {} pixels, but the model's camera has {} x {}: give the images that the model was made of",
        size.0, size.1, calibrated.0, calibrated.1
    )]
    ColmapImageSize {
        /// Its name.
        image: String,
        /// Its columns and rows.
        size: (usize, usize),
        /// Columns and rows by the model.
        calibrated: (usize, usize),
    },
    /// The poses of a COLMAP model have no covariance.
    #[error(
        "the model does not determine the poses of its images: {image} sees only {points} points that fit their pixels; \
         remove such images with `colmap image_deleter`"
    )]
    ColmapUndetermined {
        /// The image that sees the fewest points.
        image: String,
        /// Their number.
        points: usize,
    },
    /// No point of a COLMAP model has descriptors.
    #[error(
        "no point of the model has a feature of the extractor in two images ({unreadable} images cannot be read): check the \
         folder of images, and raise --max-features"
    )]
    NoDescribedPoints {
        /// Images that cannot be read.
        unreadable: usize,
    },
    /// Place recognition cannot search the map.
    #[error("places seen again cannot be searched: {0}")]
    Recognition(#[from] recognition::QueryError),
    /// Place recognition cannot load the map.
    #[error("places seen again cannot be searched: {0}")]
    Index(#[from] recognition::LoadError),
    /// The joint covariance of the poses cannot be computed.
    #[error(
        "the refined poses have no covariance: are the sigmas of the reference poses far too large? --no-refine-poses states \
         the reference poses instead"
    )]
    Indefinite,
    /// The result violates an invariant of maps.
    #[error("the map that was built is invalid, which is a fault of this program: {0}")]
    Contents(#[from] map::contents::ContentsError),
}
