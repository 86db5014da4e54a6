//! A place that is published in small cells, and queries about it.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use geometry::PoseWithCovariance;
use nalgebra::Matrix6;
use protocol::{MatchRequest, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use releases::{PublishOptions, Release, ReleaseStore, publish};
use testing::{Place, PlaceOptions};

/// A place that is published in small cells.
pub struct Town {
    pub place: Place,
    pub folder: tempfile::TempDir,
    pub city: PathBuf,
    pub store: ReleaseStore,
    pub release: Release,
}

impl Town {
    pub async fn new() -> Town {
        let place = Place::new(&PlaceOptions { keyframes: 60, landmarks: 3000, ..PlaceOptions::default() });
        let folder = tempfile::tempdir().unwrap();
        let city = folder.path().join("city");
        let store = ReleaseStore::open(city.to_str().unwrap()).unwrap();
        publish(&store, place.map.clone(), &small_cells(), |_| {}).await.unwrap();
        let release = store.newest().await.unwrap().unwrap();
        Town { place, folder, city, store, release }
    }
}

pub fn small_cells() -> PublishOptions {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 10;
    options
}

/// Queries along the path: without a prior, with one, with keyframes that the robot holds.
pub fn requests(place: &Place) -> Vec<MatchRequest> {
    let mut rng = StdRng::seed_from_u64(7);
    let mut requests = Vec::new();
    for (at, pose) in place.path.iter().enumerate().step_by(3) {
        let mut request = place.request(pose, 8, &mut rng);
        if at % 2 == 0 {
            let covariance = Matrix6::identity() * 0.05_f64.powi(2);
            request.prior =
                Some(PosePrior { global_from_camera: PoseWithCovariance::new(*pose, covariance) });
        }
        if at % 4 == 0 {
            request.held = (0..6).map(|_| 10 + rng.random_range(0..60)).collect();
            request.held.sort_unstable();
            request.held.dedup();
        }
        requests.push(request);
    }
    requests
}

pub fn soon() -> Instant {
    Instant::now() + Duration::from_secs(20)
}
