//! `driftless edit-map`: takes keyframes and landmarks out of a map.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::bail;
use map::contents::MapContents;
use map::edit::{Region, keyframes_where, redundant_keyframes, remove_keyframes, retain_landmarks};
use map::store::{MapTarget, load_map};
use mapping::BuildReport;
use nalgebra::Vector3;
use serde::Serialize;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless edit-map --map town.db --thin --dry-run\n  \
    driftless edit-map --map town.db --remove 17,20-35\n  \
    driftless edit-map --map town.db --remove-box=-5,-5,-2,5,5,2 --to town_without_hall.db\n  \
    driftless edit-map --map town.db --remove-time 1403636579000000000,1403636650000000000\n  \
    driftless edit-map --map town.db --drop-images\n\n\
    DB becomes its next version, and a server is told as after a build. What stays keeps its ids, poses and covariances:\n\
    robots stay localized. What several switches choose is taken out together; --thin then looks at what is left. A\n\
    switch that chooses nothing is an error, but for --thin beside others.")]
pub struct Args {
    /// Database of the map
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Write another map instead of the next version of DB
    #[arg(long, value_name = "DB")]
    pub to: Option<PathBuf>,
    /// Take out these keyframes, for example 3,17,20-35
    #[arg(long, value_name = "IDS", value_parser = parse_ids)]
    pub remove: Option<Ids>,
    /// Take out the keyframes in a box of the map's frame, m
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = parse_box, allow_hyphen_values = true)]
    pub remove_box: Option<Region>,
    /// Take out the keyframes of a session: those taken from the first to the second time, ns
    #[arg(long, value_name = "FROM,UNTIL", value_parser = parse_times, allow_hyphen_values = true)]
    pub remove_time: Option<[i64; 2]>,
    /// Take out the keyframes of whose landmarks at least this part is seen by three others that stay
    #[arg(long, value_name = "PART", num_args = 0..=1, default_missing_value = "0.9")]
    pub thin: Option<f64>,
    /// Take out the landmarks outside of a box of the map's frame, m
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = parse_box, allow_hyphen_values = true)]
    pub crop_landmarks: Option<Region>,
    /// Take out the images of the keyframes
    #[arg(long)]
    pub drop_images: bool,
    /// Take out the features of an added kind, for example edgepoint2-1
    #[arg(long, value_name = "EXTRACTOR")]
    pub drop_features: Option<String>,
    /// Say what would be done, and write nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Ids, first and last of each range.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ids(Vec<[u64; 2]>);

/// What a map consists of.
#[derive(Debug, Serialize)]
struct Counts {
    keyframes: usize,
    landmarks: usize,
    observations: usize,
    /// Keyframes with too few landmarks to localize by.
    poor_keyframes: usize,
    added_kinds: usize,
    images: usize,
}

/// What was done.
#[derive(Debug, Serialize)]
struct Report {
    before: Counts,
    after: Counts,
    /// Keyframes that were taken out because others show the same.
    thinned: usize,
    /// The version that was written; none with --dry-run.
    version: Option<u64>,
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read or written, a switch that chooses nothing, an edit that takes out nothing, every keyframe
/// or every landmark.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(share) = args.thin.filter(|share| !(0.0..=1.0).contains(share)) {
        bail!("--thin {share}: give a part from 0 to 1, for example 0.9");
    }
    let target = MapTarget::new(args.to.as_ref().unwrap_or(&args.map), args.to.is_none())?;
    let before = load_map(&args.map)?.contents;
    let mut contents = before.clone();
    let chosen = chosen(args, &contents)?;
    remove_keyframes(&mut contents, &chosen);
    let redundant = args.thin.map(|share| redundant_keyframes(&contents, share)).unwrap_or_default();
    remove_keyframes(&mut contents, &redundant);
    if let Some(region) = &args.crop_landmarks {
        let count = |contents: &MapContents| -> usize {
            let added = contents.added_features.iter().map(|added| added.landmarks.len());
            contents.landmarks.len() + added.sum::<usize>()
        };
        let all = count(&contents);
        retain_landmarks(&mut contents, |position| region.contains(position));
        ensure_chosen(args, "--crop-landmarks", count(&contents) < all, "every landmark is in that box")?;
    }
    drop_parts(args, &mut contents)?;
    if contents.keyframes.is_empty() {
        bail!("no keyframe would be left: remove the database instead");
    }
    if contents.landmarks.is_empty() && !before.landmarks.is_empty() {
        bail!(
            "no landmark would be left, and nobody could be localized: choose less, or remove the database instead"
        );
    }
    if contents == before {
        bail!(
            "nothing is chosen: the map stays as it is (`driftless map-info --map {}` prints its extent and times)",
            args.map.display()
        );
    }
    let mut report =
        Report { before: counts(&before), after: counts(&contents), thinned: redundant.len(), version: None };
    if !args.dry_run {
        report.version = Some(target.save(&contents)?.version);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    let line = |name: &str, of: fn(&Counts) -> usize| {
        println!("{name:<44} {:>8} -> {:>8}", of(&report.before), of(&report.after));
    };
    line("keyframes", |counts| counts.keyframes);
    line("landmarks", |counts| counts.landmarks);
    line("observations", |counts| counts.observations);
    line("keyframes with too few landmarks to localize by", |counts| counts.poor_keyframes);
    line("added kinds of features", |counts| counts.added_kinds);
    line("images", |counts| counts.images);
    match report.version {
        Some(version) => println!("{}: version {version}", target.path().display()),
        None => println!("nothing was written"),
    }
    Ok(())
}

/// Takes out images, and features of an added kind.
fn drop_parts(args: &Args, contents: &mut MapContents) -> anyhow::Result<()> {
    if args.drop_images {
        ensure_chosen(args, "--drop-images", !contents.images.is_empty(), "the map has no images")?;
        contents.images.clear();
    }
    let Some(name) = &args.drop_features else { return Ok(()) };
    if contents.info.extractor == *name {
        bail!("--drop-features {name}: the map is adjusted by these features, they cannot be taken out");
    }
    let before = contents.added_features.len();
    contents.added_features.retain(|added| added.kind.extractor != *name);
    if contents.added_features.len() == before {
        let kinds: Vec<String> = contents.feature_kinds().map(|kind| kind.extractor).collect();
        bail!("--drop-features {name}: the map has features of {}", kinds.join(" and "));
    }
    Ok(())
}

/// The keyframes that the switches choose.
fn chosen(args: &Args, contents: &MapContents) -> anyhow::Result<BTreeSet<u64>> {
    let mut chosen = BTreeSet::new();
    for &[first, last] in args.remove.iter().flat_map(|ids| &ids.0) {
        let of_range = keyframes_where(contents, |keyframe| (first..=last).contains(&keyframe.id));
        if of_range.is_empty() {
            bail!(
                "--remove: the map has no keyframe {first}{}",
                if last > first { format!(" to {last}") } else { String::new() }
            );
        }
        chosen.extend(of_range);
    }
    if let Some(region) = &args.remove_box {
        let inside = keyframes_where(contents, |keyframe| {
            region.contains(&keyframe.global_from_keyframe.pose.translation)
        });
        ensure_chosen(args, "--remove-box", !inside.is_empty(), "no keyframe is in that box")?;
        chosen.extend(inside);
    }
    if let Some([from_ns, until_ns]) = args.remove_time {
        let within = keyframes_where(contents, |keyframe| (from_ns..=until_ns).contains(&keyframe.stamp_ns));
        ensure_chosen(args, "--remove-time", !within.is_empty(), "no keyframe was taken then")?;
        chosen.extend(within);
    }
    Ok(chosen)
}

/// Refuses a switch that chooses nothing of the map, like a box in another frame.
fn ensure_chosen(args: &Args, switch: &str, is_chosen: bool, found: &str) -> anyhow::Result<()> {
    if !is_chosen {
        bail!(
            "{switch}: {found} (`driftless map-info --map {}` prints extent and times of the map)",
            args.map.display()
        );
    }
    Ok(())
}

fn counts(contents: &MapContents) -> Counts {
    let mut seen: std::collections::BTreeMap<u64, usize> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, 0)).collect();
    for observation in contents.landmarks.iter().flat_map(|landmark| &landmark.observations) {
        *seen.entry(observation.keyframe).or_default() += 1;
    }
    Counts {
        keyframes: contents.keyframes.len(),
        landmarks: contents.landmarks.len(),
        observations: contents.observation_count(),
        poor_keyframes: seen.values().filter(|count| **count < BuildReport::FEW_LANDMARKS).count(),
        added_kinds: contents.added_features.len(),
        images: contents.images.len(),
    }
}

fn parse_ids(text: &str) -> Result<Ids, String> {
    let range = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let range = [first.trim().parse().ok()?, last.trim().parse().ok()?];
        Some(range).filter(|[first, last]: &[u64; 2]| first <= last)
    };
    let ranges: Option<Vec<[u64; 2]>> = text.split(',').map(range).collect();
    ranges.map(Ids).ok_or_else(|| "ids of keyframes are needed, for example 3,17,20-35".to_owned())
}

fn parse_box(text: &str) -> Result<Region, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let region = match numbers.as_deref() {
        Some(&[x0, y0, z0, x1, y1, z1]) => {
            Some(Region { min: Vector3::new(x0, y0, z0), max: Vector3::new(x1, y1, z1) })
        }
        _ => None,
    };
    region.filter(|region| (0..3).all(|axis| region.min[axis] <= region.max[axis])).ok_or_else(|| {
        "six numbers are needed, the smaller corner first: for example -5,-5,-2,5,5,2".to_owned()
    })
}

fn parse_times(text: &str) -> Result<[i64; 2], String> {
    let times = text
        .split_once(',')
        .and_then(|(from, until)| Some([from.trim().parse().ok()?, until.trim().parse().ok()?]));
    times
        .filter(|[from, until]| from <= until)
        .ok_or_else(|| "two times in ns are needed, the earlier first".to_owned())
}
