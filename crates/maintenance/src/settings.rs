//! Settings of maintenance.

/// Settings of [`crate::take_session`].
///
/// # Example
/// ```
/// let mut settings = maintenance::Settings::default();
/// settings.half_life_days = 30.0; // racks are moved every month
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Time in which what is known of a landmark that nobody passes becomes half as certain (days).
    pub half_life_days: f64,
    /// Landmarks that exist with a smaller probability are taken out.
    pub min_existence: f64,
    /// Probability that a landmark exists when it enters the map.
    pub new_existence: f64,
    /// Keyframes of one appearance that a place keeps, at most.
    pub keyframes_a_place: usize,
    /// A further keyframe of a place and appearance is kept only where it adds at least this part of what it shows: a landmark that is
    /// shown by one already counts half, by two a quarter.
    pub min_added: f64,
    /// Appearances, such as day and night, that a place keeps, at most: those that were seen last.
    pub appearances_a_place: usize,
    /// Landmarks that a place keeps, at most: of each of its keyframes those that most others show.
    pub landmarks_a_place: usize,
    /// Radius of a place (m): no two places have their middles nearer.
    pub place_m: f64,
    /// Largest angle of a keyframe's optical axis with that of the middle of its place (rad).
    pub place_rad: f64,
    /// An appearance is taken out when nobody has seen it for so many half-lives and another one of its place was seen.
    pub unused_half_lives: f64,
    /// A session is refused when the map moves its keyframes relative to each other by more: ratio of the chi-square to its degrees of
    /// freedom.
    pub max_map_ratio: f64,
    /// A session is refused when fewer of the keyframes that show a place of the map agree with its trajectory.
    pub min_agreeing: f64,
    /// A session is refused when its pixels fit its own trajectory worse than those of the session that the map began with, by this factor.
    pub max_pixel_ratio: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            half_life_days: 90.0,
            min_existence: 0.05,
            new_existence: 0.8,
            keyframes_a_place: 2,
            min_added: 0.0,
            appearances_a_place: 4,
            landmarks_a_place: 2000,
            place_m: 2.0,
            place_rad: std::f64::consts::FRAC_PI_4,
            unused_half_lives: 2.0,
            max_map_ratio: 2.0,
            min_agreeing: 0.5,
            max_pixel_ratio: 3.0,
        }
    }
}

impl Settings {
    /// The half-life (ns).
    pub(crate) fn half_life_ns(&self) -> f64 {
        self.half_life_days * 86_400e9
    }
}
