//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

#[cfg(unix)]
mod bench;
#[path = "../../crates/viewer/tests/common/browser.rs"]
mod browser;
mod calibration;
#[cfg(unix)]
mod crossing;
mod demo;
#[cfg(all(feature = "bags", feature = "releases", feature = "secure"))]
mod devices;
#[cfg(all(feature = "bags", feature = "releases", feature = "secure"))]
mod documentation;
#[cfg(unix)]
mod ending;
mod features;
mod fleet;
#[cfg(target_os = "linux")]
mod full_disk;
#[cfg(unix)]
mod gnss;
#[cfg(all(unix, feature = "releases"))]
mod hand_in;
#[cfg(unix)]
mod imu_model;
#[cfg(unix)]
mod kills;
#[cfg(all(unix, feature = "releases"))]
mod ledger;
#[cfg(all(feature = "bags", feature = "releases", feature = "secure"))]
mod links;
#[cfg(unix)]
mod live_page;
#[cfg(all(unix, feature = "releases"))]
mod maintain;
#[cfg(feature = "manual")]
mod manual;
mod maps;
mod old_spellings;
#[cfg(all(feature = "bags", feature = "releases", feature = "secure"))]
mod printed;
mod program;
mod rendered_images;
#[cfg(all(unix, feature = "releases"))]
mod review;
#[cfg(unix)]
mod scratch;
mod simulate_evaluate_plot;
mod track;
