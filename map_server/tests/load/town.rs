//! A served town, and robots that query it: shared by the measurements.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use geometry::PoseWithCovariance;
use geometry::uncertain_pose::isotropic_covariance;
use map::store;
use protocol::{MatchRequest, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use testing::{Place, PlaceOptions};

/// Name of the served map.
pub const MAP: &str = "town";

/// A number from the environment.
pub fn setting(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// A running map server, ended whatever happens.
pub struct Server(Child);

impl Server {
    /// Stores the map of a place in `folder` and serves it, on processor 0 where `taskset` is installed, or on as many as `PROCESSORS`
    /// in the environment says, with a worker for each.
    ///
    /// `log`: where its log goes; `None`: to that of the test.
    pub fn start(place: &Place, folder: &Path, endpoint: &str, log: Option<File>) -> Self {
        Self::start_with(place, folder, endpoint, log, &[])
    }

    /// The same, with other switches.
    pub fn start_with(
        place: &Place,
        folder: &Path,
        endpoint: &str,
        log: Option<File>,
        switches: &[&str],
    ) -> Self {
        let database = folder.join("town.db");
        store::save_map(&database, &place.map, false).unwrap();
        let program = env!("CARGO_BIN_EXE_map_server");
        let processors = setting("PROCESSORS", 1);
        let has_taskset = Command::new("taskset").arg("-V").stdout(Stdio::null()).status().is_ok();
        let mut command = if has_taskset {
            let mut command = Command::new("taskset");
            command.args(["-c", &format!("0-{}", processors - 1), program]);
            command
        } else {
            Command::new(program)
        };
        if let Some(log) = log {
            command.stderr(log.try_clone().unwrap()).stdout(log);
        }
        let map = format!("{MAP}={}", database.display());
        command
            .args(["--map", &map, "--listen", endpoint, "--workers", &processors.to_string()])
            .arg("--state")
            .arg(folder.join("state"))
            .args(switches);
        Self(command.spawn().unwrap())
    }

    /// Memory that it has now and had at most, in MB.
    pub fn memory_mb(&self) -> [f64; 2] {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).unwrap();
        ["VmRSS:", "VmHWM:"].map(|name| {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
            line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() * 1.024e-3
        })
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.0.id()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A place of so many keyframes.
pub fn town(keyframes: usize) -> Place {
    Place::new(&PlaceOptions { keyframes, landmarks: 50 * keyframes, ..PlaceOptions::default() })
}

/// Requests from places along the path of a map; `has_prior` states the pose to 0.3 m and 3 deg.
pub fn requests(place: &Place, has_prior: bool, seed: u64) -> Vec<MatchRequest> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut from_somewhere = || {
        let pose = place.path[rng.random_range(0..place.path.len())];
        let mut request = place.request(&pose, 4, &mut rng);
        let covariance = isotropic_covariance(0.05, 0.3);
        request.prior =
            has_prior.then(|| PosePrior { global_from_camera: PoseWithCovariance::new(pose, covariance) });
        request
    };
    (0..20).map(|_| from_somewhere()).collect()
}

/// A quantile of sorted durations, milliseconds.
pub fn quantile_ms(sorted: &[Duration], part: f64) -> f64 {
    let index = ((sorted.len() as f64 * part) as usize).min(sorted.len().saturating_sub(1));
    sorted.get(index).map_or(f64::NAN, |duration| duration.as_secs_f64() * 1e3)
}
