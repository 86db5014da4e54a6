//! The review of a candidate: drives are localized in it and in the live release, and gates say whether it may be promoted.
//!
//! A change of a map is wrong where it is not what the place looks like, and that shows where robots are localized in it. So each
//! drive is run twice, as a robot and image by image without any prior, and what is compared are the two: a drive that is hard in
//! both maps refuses nobody. What no drive has seen is judged by the map alone: motions that the live map's own covariance does not
//! explain, and places that lost all of their keyframes.
//!
//! | module | what |
//! |---|---|
//! | `drive` | a drive in one map |
//! | `figures` | how well it was localized |
//! | `structure` | what is different between the maps |
//! | `gates` | what is refused, and why |
//! | `page` | the report |

mod drive;
mod figures;
mod gates;
mod page;
mod structure;

pub use drive::{Drive, DriveRun};
pub use figures::{ColdFigures, DriveFigures, ErrorFigures, Reference};
pub use gates::{Gates, Refusal};
pub use page::write_page;
pub use structure::{MapFigures, Structure};

use anyhow::Result;
use recognition::LoadedMap;
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;

/// A map under review, or the one that it is compared with.
#[derive(Clone)]
pub struct Side {
    /// Its name for a person, like `release 7`.
    pub title: String,
    /// The map.
    pub map: Arc<LoadedMap>,
}

/// What a review found.
#[derive(Clone, Debug, Serialize)]
pub struct Review {
    /// What the candidate is compared with.
    pub live: String,
    /// What is reviewed.
    pub candidate: String,
    /// How the maps differ.
    pub structure: Structure,
    /// How drives are localized in both.
    pub drives: Vec<ReviewedDrive>,
    /// What was allowed.
    pub gates: Gates,
    /// Why it should not be promoted; empty where nothing speaks against it.
    pub refusals: Vec<Refusal>,
}

/// A drive in both maps.
#[derive(Clone, Debug, Serialize)]
pub struct ReviewedDrive {
    /// The recording.
    pub recording: String,
    /// In the live release.
    pub live: DriveFigures,
    /// In the candidate.
    pub candidate: DriveFigures,
    /// Positions in the candidate, for the page.
    #[serde(skip)]
    path: Vec<[f64; 2]>,
}

impl Review {
    /// Reviews a candidate.
    ///
    /// # Arguments
    /// * `out`: folder for what the robots write, a folder for each drive and map.
    ///
    /// # Errors
    /// A drive that cannot be read or run, a folder that cannot be written.
    pub fn of(live: &Side, candidate: &Side, drives: &[Drive], gates: &Gates, out: &Path) -> Result<Self> {
        let mut reviewed = Vec::new();
        for (number, drive) in (1..).zip(drives) {
            let folder = out.join(format!("drive-{number}"));
            let in_live = drive.run_in(&live.map, &folder.join("live"))?;
            let in_candidate = drive.run_in(&candidate.map, &folder.join("candidate"))?;
            reviewed.push(ReviewedDrive::of(drive, &in_live, &in_candidate));
        }
        Ok(Self::judged(live, candidate, reviewed, gates))
    }

    /// Puts what was found together, and applies the gates.
    pub fn judged(live: &Side, candidate: &Side, drives: Vec<ReviewedDrive>, gates: &Gates) -> Self {
        let structure = Structure::between(&live.map, &candidate.map);
        let mut refusals = gates.structure(&structure);
        for drive in &drives {
            refusals.extend(gates.drive(drive));
        }
        Self {
            live: live.title.clone(),
            candidate: candidate.title.clone(),
            structure,
            drives,
            gates: gates.clone(),
            refusals,
        }
    }
}

impl ReviewedDrive {
    /// Compares a drive in both maps.
    pub fn of(drive: &Drive, live: &DriveRun, candidate: &DriveRun) -> Self {
        let reference = Reference::of(live);
        let of_live = DriveFigures::of(live, &reference);
        // Without truth they are compared with themselves.
        let errors = of_live.errors.clone().filter(|errors| errors.is_to_truth);
        Self {
            recording: drive.name().to_owned(),
            live: DriveFigures { errors, ..of_live },
            candidate: DriveFigures::of(candidate, &reference),
            path: candidate.path(),
        }
    }
}
