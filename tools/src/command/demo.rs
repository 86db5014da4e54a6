//! `driftless demo`: the whole system in a minute.

use crate::demo::{Demo, Row, run_demo};
use evaluation::Score;
use indicatif::ProgressBar;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless demo --out demo --seed 2\n\n\
    Simulates a place and two runs through it, builds a map from the first, serves it over Zenoh on the\n\
    loopback interface, and localizes a robot in it, once for each variant of the paper's table:\n\
    SM one keyframe a query, MM several, +R with re-linearization, mapconst taking the map for exact.\n\
    NEES is the squared error in units of the filter's own covariance, per degree of freedom: 1 is honest.")]
pub struct Args {
    /// Folder for the map, the runs and the pictures
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    /// Another seed, another place
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A folder that cannot be written, or no free port for the server.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let spinner = if args.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    spinner.enable_steady_tick(Duration::from_millis(100));
    let demo = run_demo(&args.out, args.seed, &mut |what| spinner.set_message(what.to_owned()))?;
    spinner.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&demo)?);
    } else {
        print_table(&demo);
        println!("\npictures:");
        for picture in &demo.pictures {
            println!("  {}", picture.display());
        }
    }
    Ok(())
}

fn print_table(demo: &Demo) {
    println!(
        "{:.0} m in a map of {} keyframes and {} landmarks\n",
        demo.distance_m, demo.map.keyframes, demo.map.landmarks
    );
    println!("            pose in G                local pose       G_T_L            queries");
    println!("            deg     m       NEES     deg     m        deg     m        accepted     ms/frame");
    for row in &demo.rows {
        println!("{}", line(row));
    }
    println!("\n(odometry: its local pose, as if L had been put where it truly lies)");
}

fn line(row: &Row) -> String {
    let pair = |score: Option<&Score>| {
        score.map_or_else(
            || format!("{:17}", "-"),
            |score| format!("{:<8.3}{:<9.3}", score.rmse_deg, score.rmse_m),
        )
    };
    let nees = row.pose.as_ref().and_then(|score| score.nees_pose);
    let nees = nees.map_or_else(|| "-".to_owned(), |nees| format!("{nees:.2}"));
    let pose = row.pose.as_ref().map_or_else(
        || format!("{:16}", "-"),
        |score| format!("{:<8.3}{:<8.3}", score.rmse_deg, score.rmse_m),
    );
    format!(
        "{:12}{pose}{nees:9}{}{}{:>3} of {:<4}  {:.1}",
        row.name,
        pair(row.local.as_ref()),
        pair(row.transform.as_ref()),
        row.accepted,
        row.sent,
        row.milliseconds_per_frame
    )
}
