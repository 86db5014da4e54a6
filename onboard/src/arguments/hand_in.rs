//! What a robot records for its map.

use super::OUTPUT;
use clap::Args;
use std::path::PathBuf;

/// Switches of the sessions that a robot hands in.
#[derive(Args, Clone, Debug)]
pub struct HandInArguments {
    /// Record sessions that the map can be extended by, in this folder: readings, tracks, features and what the map answered, no
    /// images and no poses
    ///
    /// `driftless hand-in` hands them in, and `driftless build-map --extend` extends a map by them.
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    pub hand_in: Option<PathBuf>,
    /// Sign sessions with this secret key of driftless release-key or minisign; the password of an encrypted one is taken from
    /// DRIFTLESS_KEY_PASSWORD
    #[arg(long, value_name = "KEY", requires = "hand_in", help_heading = OUTPUT)]
    pub hand_in_key: Option<PathBuf>,
    /// Kilobytes that a minute of a session may have
    #[arg(long, value_name = "KB", default_value_t = 900, value_parser = clap::value_parser!(u32).range(100..), help_heading = OUTPUT)]
    pub hand_in_rate: u32,
    /// Minutes after which a session ends and the next begins
    #[arg(long, value_name = "MINUTES", default_value_t = 10.0, help_heading = OUTPUT)]
    pub hand_in_minutes: f64,
    /// Megabytes of sessions in the folder from which on no session is begun
    #[arg(long, value_name = "MB", default_value_t = 1000, help_heading = OUTPUT)]
    pub hand_in_limit: u32,
}
