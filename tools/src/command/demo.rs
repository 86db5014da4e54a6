//! `driftless demo`: the whole system in a minute.

use crate::demo::conditions::Conditions;
use crate::demo::figures::Figures;
use crate::demo::{Demo, Row, run_demo};
use indicatif::ProgressBar;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless demo --out demo --seeds 5\n\n\
    For each seed: simulates a town and two runs through it, builds a map from the first run, serves it over Zenoh\n\
    on the loopback interface, and localizes a robot in it, once for each variant. The conditions are printed with\n\
    the table, and with the same sentences in OUT/comparison.svg; OUT/demo.json has all figures, also by seed.\n\n\
    RMSE    root mean square error of the pose in the map's frame G, not aligned\n\
    claims  root mean square of the standard deviation that the filter's own covariance states; should equal RMSE\n\
    NEES    squared error in units of that covariance, per degree of freedom: 1 is consistent, above is overconfident")]
pub struct Args {
    /// Folder for the map, the runs and the plots
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
    /// First seed; each seed is another town
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds behind each figure
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Print the figures as JSON
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
    let conditions = Conditions::new(args.seed, args.seeds);
    let demo = run_demo(&args.out, &conditions, &mut |step| spinner.set_message(step.to_owned()))?;
    spinner.finish_and_clear();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&demo)?);
    } else {
        print_table(&demo);
        println!("\nplots:");
        for picture in &demo.pictures {
            println!("  {}", picture.display());
        }
    }
    Ok(())
}

fn print_table(demo: &Demo) {
    for sentence in &demo.conditions_text {
        println!("{sentence}");
    }
    println!(
        "{:.0} m in maps of {:.0} keyframes and {:.0} landmarks\n",
        demo.distance_m, demo.keyframes, demo.landmarks
    );
    println!(
        "{:10}{:^16}{:^16}{:^8}{:^16}{:^16}{:^11}",
        "", "pose in G: RMSE", "claims", "", "local pose", "G_T_L", "queries"
    );
    println!(
        "{:10}{:>7}{:>7}  {:>7}{:>7}  {:>7} {:>7}{:>7}  {:>7}{:>7}  {:>11}",
        "", "m", "deg", "m", "deg", "NEES", "m", "deg", "m", "deg", "used"
    );
    for row in &demo.rows {
        println!("{}", line(row));
    }
    println!();
    for row in &demo.rows {
        println!("{:10}{}", row.name, row.description);
    }
    println!("(odometry in G: its local pose, as if L had been placed where it truly is)");
}

fn line(row: &Row) -> String {
    let pair = |values: Option<(f64, f64)>| {
        values.map_or_else(
            || format!("{:>7}{:>7}  ", "-", "-"),
            |(metres, degrees)| format!("{metres:>7.3}{degrees:>7.3}  "),
        )
    };
    let rmse = |figures: &Option<Figures>| pair(figures.map(|figures| (figures.rmse_m, figures.rmse_deg)));
    let claimed = pair(row.pose.map(|figures| (figures.sigma_m, figures.sigma_deg)));
    let nees = row.pose.and_then(|figures| figures.nees_pose);
    let nees = nees.map_or_else(|| "-".to_owned(), |nees| format!("{nees:.2}"));
    format!(
        "{:10}{}{claimed}{nees:>7} {}{}{:>4} of {}",
        row.name,
        rmse(&row.pose),
        rmse(&row.local),
        rmse(&row.transform),
        row.used,
        row.sent
    )
}
