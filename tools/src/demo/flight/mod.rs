//! From pixels: two flights through a rendered room. The first becomes a map, by images and IMU alone; a server answers the
//! queries of the second, whose images are recognized.
//!
//! | module | what |
//! |---|---|
//! | [`conditions`] | what is simulated, in numbers and in sentences |
//! | `mapped` | the map of the first flight, and the truth in its frame |
//! | `picture` | the comparison, the plots of the run, an image |

pub mod conditions;
mod mapped;
mod picture;

use super::CREATED_BY;
use super::robot::{Run, Variant};
use super::rows::{Row, RowSums};
use crate::in_process::{LocalServer, load_map};
use crate::open_page::announce;
use crate::own_map::is_replaceable;
use anyhow::{Context as _, Result, ensure};
use conditions::FlightConditions;
pub use mapped::MapFigures;
use mapped::MappedRoom;
use onboard::arguments::{Init, Mode};
use sensors::{Sequence, writer};
use serde::Serialize;
use simulation::images::{render_all, simulate_images};
use std::path::{Path, PathBuf};

/// The rows of the table, in its order.
pub const VARIANTS: [Variant; 2] = [
    Variant::ODOMETRY,
    Variant {
        name: "MM+R",
        description: "in the map, several keyframes a query",
        folder: "mm_r",
        mode: Mode::Multi,
    },
];

/// What the demo computed.
#[derive(Clone, Debug, Serialize)]
pub struct FlightDemo {
    /// What was simulated.
    pub conditions: FlightConditions,
    /// The same in sentences.
    pub conditions_text: Vec<String>,
    /// Distance travelled in the live run, metres.
    pub distance_m: f64,
    /// The map.
    pub map: MapFigures,
    /// The table.
    pub rows: Vec<Row>,
    /// Plots and images that were written.
    pub pictures: Vec<PathBuf>,
    /// Database of the map.
    pub map_database: PathBuf,
    /// Folder of the run in the map.
    pub run: PathBuf,
}

/// Runs the demo from pixels.
///
/// # Arguments
/// * `out`: folder for `demo.json`, `comparison.svg`, the map, the live recording without its images, and a folder for each run.
/// * `is_shown`: whether the live map is opened in the browser when the robot starts.
/// * `progress`: called with what is being done.
///
/// # Returns
/// What was computed, and the map server, which still runs.
///
/// # Errors
/// A folder that cannot be written, or that has a map or a recording of others where these are written; no free port
/// for the server, a run that fails.
pub fn run_flight(
    out: &Path,
    conditions: &FlightConditions,
    is_shown: bool,
    progress: &mut dyn FnMut(&str),
) -> Result<(FlightDemo, LocalServer)> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot create the folder {}", out.display()))?;
    let (database, root) = (out.join("map.db"), out.join("live"));
    let is_again = is_replaceable(&database, CREATED_BY)?;
    ensure!(
        is_again || !root.join("mav0").exists(),
        "{} is a recording, and is not replaced: name another folder with --out, or remove it",
        root.display()
    );
    progress("simulating a room");
    let (simulation, images) = conditions.simulation();
    let scenario = simulate_images(&simulation, &images)?;
    let mut flight = scenario.map;
    render(&mut flight, "map", progress)?;
    let mapped = MappedRoom::build(flight, &database, progress)?;
    let mut live = scenario.live;
    render(&mut live, "live", progress)?;
    mapped.place_truth(&mut live);
    live.root = root;
    write_without_images(&live)?;
    let mut server = LocalServer::start(vec![("demo".to_owned(), load_map(&database)?)])?;
    if is_shown {
        announce(&server.show()?);
    }
    let runs = run_all(&live, out, &server, progress)?;
    progress("drawing");
    let rows = VARIANTS.iter().zip(&runs).map(|(variant, run)| {
        let mut sums = RowSums::default();
        sums.add(conditions.seed, run);
        sums.finish(variant)
    });
    let [_, in_map] = &runs;
    let mut demo = FlightDemo {
        conditions: *conditions,
        conditions_text: conditions.describe(&simulation),
        distance_m: in_map.distance_m,
        map: mapped.figures,
        rows: rows.collect(),
        pictures: Vec::new(),
        map_database: database,
        run: in_map.folder.clone(),
    };
    demo.pictures = picture::draw_all(&live, &mapped, &runs, &demo, out)?;
    std::fs::write(out.join("demo.json"), serde_json::to_string_pretty(&demo)?)?;
    Ok((demo, server))
}

fn render(sequence: &mut Sequence, run: &str, progress: &mut dyn FnMut(&str)) -> Result<()> {
    render_all(sequence, |done, all| {
        progress(&format!("rendering the {run} flight: {done} of {all} images"));
    })?;
    Ok(())
}

/// Writes the recording so that the view finds its truth.
fn write_without_images(live: &Sequence) -> Result<()> {
    let mut recording = live.clone();
    for frame in &mut recording.frames {
        frame.images.clear();
    }
    writer::write(&recording, &live.root).context("the live recording was not written")
}

/// Runs all variants at the same time.
fn run_all(
    live: &Sequence,
    out: &Path,
    server: &LocalServer,
    progress: &mut dyn FnMut(&str),
) -> Result<[Run; VARIANTS.len()]> {
    let links = [server.link("demo")?, server.link("demo")?];
    let frames = live.frames.len();
    let run = |index: usize, show: &mut dyn FnMut(usize)| {
        Run::of(live, VARIANTS[index], (out, Init::Auto), links[index].clone(), show)
    };
    let runs = std::thread::scope(|scope| {
        let odometry = scope.spawn(|| run(0, &mut |_| {}));
        let in_map = run(1, &mut |frame| {
            progress(&format!("localizing the live flight: {} of {frames} frames", frame + 1));
        });
        let odometry = odometry.join().map_err(|_| anyhow::anyhow!("the run of odometry panicked"))?;
        Ok::<_, anyhow::Error>([odometry?, in_map?])
    });
    for link in &links {
        server.unlink(link);
    }
    runs
}
