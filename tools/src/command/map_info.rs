//! `driftless map-info`: the contents of a map.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::bail;
use geometry::PoseWithCovariance;
use indicatif::ProgressBar;
use map::contents::MapContents;
use map::sessions::{NamedSession, Session, utc_time};
use map::{FeatureKind, Landmark};
use nalgebra::Vector3;
use protocol::MapIdentity;
use recognition::likely_alias;
use serde::Serialize;

use crate::map_aliases::MapAliases;
use crate::map_place::{NamedMap, read_map};
use mapping::Spread;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  driftless map-info --map yq.db\n  driftless map-info --map s3://bucket/city@candidate\n  \
                        driftless map-info --map yq.db --audit\n\n\
                        The sigmas are standard deviations of the keyframes' poses per axis, as build-map prints them.\n\
                        The identity is the same for all versions of a map, and different for different maps."
)]
pub struct Args {
    /// Database of the map, or its releases: a folder or URL, with @7 for release 7, or @candidate
    #[arg(long, value_name = "DB|URL")]
    pub map: PathBuf,
    /// List the keyframes whose image could be taken for another place. Those of which the map does not state it are
    /// compared with the rest of the map first
    #[arg(long)]
    pub aliases: bool,
    /// Check the ledger of sessions: each keyframe has one session, the counts are those of the map, and no two sessions have the same
    /// readings. Fails where it is not true
    #[arg(long)]
    pub audit: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Everything that is printed.
#[derive(Serialize)]
struct Summary {
    map: PathBuf,
    /// Which release it is, where it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    release: Option<String>,
    name: String,
    created_by: String,
    version: u64,
    identity: Option<MapIdentity>,
    schema: u16,
    bytes_on_disk: u64,
    keyframes: usize,
    landmarks: usize,
    observations: usize,
    cross_covariances: usize,
    common_errors: usize,
    /// Keyframes of which the map states what they could be taken for, and those of them that could be taken for another place.
    compared_for_aliases: usize,
    aliased: usize,
    descriptor_kind: &'static str,
    descriptor_bytes: u16,
    sigma_px: f64,
    /// All kinds of features, the primary one first.
    feature_kinds: Vec<KindSummary>,
    images: ImageSummary,
    gravity_in_global: Option<[f64; 3]>,
    /// The ledger: which recordings the map was made of.
    sessions: Vec<Session>,
    /// With `--audit`: what is wrong with the ledger.
    #[serde(skip_serializing_if = "Option::is_none")]
    ledger_problems: Option<Vec<String>>,
    /// Corners of the box around all keyframes (m).
    extent_min_m: Option<[f64; 3]>,
    extent_max_m: Option<[f64; 3]>,
    /// Time between the first and the last keyframe (s).
    duration_s: f64,
    /// Standard deviations of a pose per axis (root mean square over the three), by keyframe.
    sigma_theta_deg: Spread,
    sigma_p_m: Spread,
    observations_per_landmark: Spread,
    landmarks_per_keyframe: Spread,
    landmark_depth_m: Spread,
    #[serde(skip_serializing_if = "Option::is_none")]
    aliasing: Option<MapAliases>,
}

/// A kind of features.
#[derive(Serialize)]
struct KindSummary {
    extractor: String,
    descriptor_kind: &'static str,
    descriptor_bytes: u16,
    sigma_px: f64,
    landmarks: usize,
    observations: usize,
    /// Of its landmarks on disk.
    bytes: u64,
}

impl KindSummary {
    fn of(kind: FeatureKind, landmarks: &[Landmark]) -> Self {
        Self {
            extractor: kind.extractor,
            descriptor_kind: kind.descriptor_kind.label(),
            descriptor_bytes: kind.descriptor_width,
            sigma_px: kind.sigma_px,
            landmarks: landmarks.len(),
            observations: landmarks.iter().map(|landmark| landmark.observations.len()).sum(),
            bytes: landmarks.iter().map(Landmark::bytes_on_disk).sum(),
        }
    }
}

/// The images that the map keeps.
#[derive(Serialize)]
struct ImageSummary {
    count: usize,
    bytes: usize,
}

/// Runs the command.
///
/// # Errors
/// A database that is missing, unfinished or damaged, a release that cannot be read; with `--audit`, a ledger that is not true.
pub fn run(args: Args) -> anyhow::Result<()> {
    let stored = read_map(&args.map)?;
    let mut summary = summary(args.map, &stored);
    if args.audit {
        let problems = stored.contents.audit_sessions();
        summary.ledger_problems = Some(problems.iter().map(ToString::to_string).collect());
    }
    if args.aliases {
        let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new(0) };
        summary.aliasing = Some(MapAliases::of(stored.contents, &bar)?);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print_summary(&summary);
    }
    if let [first, others @ ..] = &summary.ledger_problems.unwrap_or_default()[..] {
        let others = if others.is_empty() { String::new() } else { format!(" (and {} more)", others.len()) };
        bail!(
            "the ledger of sessions is not true: {first}{others}. Go back to a version of the map whose ledger is true, or build the map \
             again from its recordings"
        );
    }
    Ok(())
}

fn summary(map: PathBuf, stored: &NamedMap) -> Summary {
    let contents: &MapContents = &stored.contents;
    let positions =
        || contents.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
    let corner = |pick: fn(f64, f64) -> f64| -> Option<[f64; 3]> {
        positions().reduce(|a: Vector3<f64>, b| a.zip_map(&b, pick)).map(Into::into)
    };
    let poses = || contents.keyframes.iter().map(|keyframe| &keyframe.global_from_keyframe);
    let mut seen: BTreeMap<u64, usize> = contents.keyframes.iter().map(|keyframe| (keyframe.id, 0)).collect();
    for observation in contents.landmarks.iter().flat_map(|landmark| &landmark.observations) {
        *seen.entry(observation.keyframe).or_default() += 1;
    }
    let stamps = || contents.keyframes.iter().map(|keyframe| keyframe.stamp_ns);
    let duration_ns =
        stamps().max().zip(stamps().min()).map_or(0, |(last, first)| last.saturating_sub(first));
    Summary {
        map,
        release: stored.release.clone(),
        name: contents.info.name.clone(),
        created_by: contents.info.created_by.clone(),
        version: contents.info.version,
        identity: contents.info.identity,
        schema: contents.store_schema(),
        bytes_on_disk: stored.bytes,
        keyframes: contents.keyframes.len(),
        landmarks: contents.landmarks.len(),
        observations: contents.observation_count(),
        cross_covariances: contents.cross_covariances.len(),
        common_errors: contents.common_errors.len(),
        compared_for_aliases: contents.aliases.len(),
        aliased: contents.aliases.iter().filter_map(likely_alias).count(),
        descriptor_kind: contents.info.descriptor_kind.label(),
        descriptor_bytes: contents.info.descriptor_width,
        sigma_px: contents.info.sigma_px,
        feature_kinds: contents
            .landmarks_of_kinds()
            .map(|(kind, landmarks)| KindSummary::of(kind, landmarks))
            .collect(),
        images: ImageSummary {
            count: contents.images.len(),
            bytes: contents.images.iter().map(|image| image.jpeg.len()).sum(),
        },
        gravity_in_global: contents.info.gravity_in_global.map(Into::into),
        sessions: contents.info.sessions.clone(),
        ledger_problems: None,
        extent_min_m: corner(f64::min),
        extent_max_m: corner(f64::max),
        duration_s: duration_ns as f64 * 1e-9,
        sigma_theta_deg: Spread::of(poses().map(|pose| pose.sigma_theta_rad().to_degrees())),
        sigma_p_m: Spread::of(poses().map(PoseWithCovariance::sigma_p_m)),
        observations_per_landmark: Spread::of(
            contents.landmarks.iter().map(|landmark| landmark.observations.len() as f64),
        ),
        landmarks_per_keyframe: Spread::of(seen.values().map(|&count| count as f64)),
        landmark_depth_m: Spread::of(contents.landmarks.iter().map(|landmark| landmark.position_in_anchor.z)),
        aliasing: None,
    }
}

fn print_summary(summary: &Summary) {
    let vector = |values: Option<[f64; 3]>, unknown: &str| {
        values.map_or_else(|| unknown.to_owned(), |[x, y, z]| format!("({x:.2}, {y:.2}, {z:.2})"))
    };
    let spread = |spread: &Spread, digits: usize| {
        let Spread { mean, median, p95 } = spread;
        format!("mean {mean:.digits$}, median {median:.digits$}, 95 % below {p95:.digits$}")
    };
    println!("map                      {}", summary.map.display());
    if let Some(release) = &summary.release {
        println!("  release                {release}");
    }
    println!("  name                   {}, by {}", summary.name, summary.created_by);
    println!("  version                {} (schema {})", summary.version, summary.schema);
    if let Some(identity) = summary.identity {
        println!("  identity               {identity}");
    }
    println!("  size on disk           {:.2} MB", summary.bytes_on_disk as f64 * 1e-6);
    println!("keyframes                {} over {:.1} s", summary.keyframes, summary.duration_s);
    println!(
        "  extent, m              {} to {}",
        vector(summary.extent_min_m, "none"),
        vector(summary.extent_max_m, "none")
    );
    println!("  sigma per axis, deg    {}", spread(&summary.sigma_theta_deg, 3));
    println!("  sigma per axis, m      {}", spread(&summary.sigma_p_m, 3));
    println!("  cross-covariances      {}", summary.cross_covariances);
    println!("  common errors          {}", summary.common_errors);
    match summary.compared_for_aliases {
        0 => println!("  places that look alike not searched: --aliases"),
        compared => println!(
            "  places that look alike {} of {compared} keyframes could be another place",
            summary.aliased
        ),
    }
    println!("landmarks                {}", summary.landmarks);
    println!("  depth in anchor, m     {}", spread(&summary.landmark_depth_m, 1));
    println!("  a keyframe             {}", spread(&summary.landmarks_per_keyframe, 0));
    println!("observations             {}", summary.observations);
    println!("  a landmark             {}", spread(&summary.observations_per_landmark, 1));
    println!("features                 {} kind(s)", summary.feature_kinds.len());
    for kind in &summary.feature_kinds {
        let name = if kind.extractor.is_empty() { "unknown extractor" } else { &kind.extractor };
        println!(
            "  {name:<22} {} landmarks, {} observations, {:.2} MB; {}, {} bytes; pixel sigma {:.2} px",
            kind.landmarks,
            kind.observations,
            kind.bytes as f64 * 1e-6,
            kind.descriptor_kind,
            kind.descriptor_bytes,
            kind.sigma_px
        );
    }
    match summary.images.count {
        0 => println!("images                   none kept"),
        count => println!(
            "images                   {count} of {} keyframes, {:.2} MB",
            summary.keyframes,
            summary.images.bytes as f64 * 1e-6
        ),
    }
    println!("gravity points to        {}", vector(summary.gravity_in_global, "unknown"));
    print_sessions(summary);
    if let Some(aliasing) = &summary.aliasing {
        aliasing.print();
    }
}

fn print_sessions(summary: &Summary) {
    match summary.sessions.len() {
        0 => println!("sessions                 not known"),
        count => println!("sessions                 {count}"),
    }
    for session in &summary.sessions {
        let begin = utc_time((session.begin_ns / 1_000_000_000).max(0) as u64);
        let seconds = session.end_ns.saturating_sub(session.begin_ns) as f64 * 1e-9;
        let added = session.added_unix_s.map_or_else(|| "never".to_owned(), utc_time);
        println!("  {}", NamedSession::from(session));
        println!(
            "    {} observations, {} of them of other sessions' landmarks; added {added} by {}",
            session.observations, session.seen_again, session.added_by
        );
        println!(
            "    {seconds:.1} s from {begin}, {} images, {} readings of the IMU",
            session.images, session.readings
        );
    }
    match summary.ledger_problems.as_deref() {
        None => {}
        Some([]) => println!("  audit                  the ledger is true"),
        Some(problems) => problems.iter().for_each(|problem| println!("  audit                  {problem}")),
    }
}
