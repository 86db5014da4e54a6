//! `driftless maintain`: keeps a map true by the sessions that robots have handed in.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use maintenance::Settings;
use map::MapContents;
use map::store::{MapTarget, load_map};
use mapping::Stage;

#[cfg(feature = "releases")]
use map::sessions::SessionId;
#[cfg(feature = "releases")]
use releases::Outcome;

use super::build_report::print_partial_kinds;
use crate::maintenance_job::{
    DoubtfulSession, JobReport, MapStorage, RefusedSession, RefusedSessions, Storage, TakenSession, Watch,
    maintain, remove_taken,
};
use crate::stage_bar::StageBar;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless maintain --map hall.db --inbox inbox --dry-run\n  \
    driftless maintain --map hall.db --inbox inbox --report night.json\n  \
    driftless maintain --map hall.db monday.session tuesday.session --half-life 30\n  \
    driftless maintain --map hall.db --inbox inbox --to s3://bucket/hall    (needs the feature releases)\n\n\
    Sessions are taken once, the oldest first. Each is located in the map, whose poses stay as they are. One that was handed in before,\n\
    is of another place, contradicts the map (a wrong calibration) or cannot be read is refused, with the reason, and the others are\n\
    taken. What a session should have seen and did not becomes less likely to be there; landmarks that are gone and keyframes that\n\
    show too little of what is left are taken out, and a place keeps a bounded number of keyframes of each appearance,\n\
    and of landmarks.\n\n\
    All of it becomes a new version of DB, in one step, and where it lasts, one every ten minutes. A run that finds nothing new writes no\n\
    version. A session that is refused is looked at again when the map or the settings have changed: the map may have grown to its place\n\
    (DB.refused.json remembers them). One that contradicts the map is looked at again when a tenth of the keyframes are others. One that\n\
    the program was ended with twice is passed over. To discard a session, delete its .session file.\n\n\
    With --to, sessions of the map that neither the newest release nor a candidate has are proposed even where nothing new came in:\n\
    a night whose store was away is made up for.")]
pub struct Args {
    /// Session files, or folders of them
    #[arg(value_name = "FILE|DIR", required_unless_present = "inbox")]
    sessions: Vec<PathBuf>,
    /// Database of the map
    #[arg(long, value_name = "DB")]
    map: PathBuf,
    /// The inbox of a map server, with the sessions of its robots; those whose robots asked another map are passed over
    #[arg(long, value_name = "DIR")]
    inbox: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArgs,
    #[cfg(feature = "releases")]
    #[command(flatten)]
    publishing: PublishingArgs,
    /// Say what would be done, and write nothing
    #[arg(long)]
    dry_run: bool,
    /// While sessions come in, write what was done so far after so many minutes, as a version of the map
    #[arg(long, value_name = "MINUTES", default_value_t = 10.0)]
    save_minutes: f64,
    /// Delete the files of sessions that the map has from the inbox, once it is written
    #[arg(long, requires = "inbox", conflicts_with = "dry_run")]
    remove_taken: bool,
    /// Write what was done to a file, as JSON, with the positions of what is gone
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print what was done as JSON
    #[arg(long)]
    json: bool,
}

/// How long landmarks are believed in, and how much of a place is kept.
#[derive(Clone, Debug, clap::Args)]
struct SettingsArgs {
    /// Time in which what is known of a landmark that nobody passes becomes half as certain
    #[arg(long, value_name = "DAYS", default_value_t = Settings::default().half_life_days)]
    half_life: f64,
    /// Take out landmarks that are there with a smaller probability
    #[arg(long, value_name = "P", default_value_t = Settings::default().min_existence)]
    min_existence: f64,
    /// Keyframes of one appearance that a place keeps
    #[arg(long, value_name = "N", default_value_t = Settings::default().keyframes_a_place as u64, value_parser = clap::value_parser!(u64).range(1..))]
    keyframes_per_place: u64,
    /// Keep another keyframe of a place only where it adds this part of what it shows; what one shows already counts half
    #[arg(long, value_name = "PART", default_value_t = Settings::default().min_added)]
    min_added: f64,
    /// Appearances that a place keeps, such as day and night
    #[arg(long, value_name = "N", default_value_t = Settings::default().appearances_a_place as u64, value_parser = clap::value_parser!(u64).range(1..))]
    appearances_per_place: u64,
    /// Landmarks that a place keeps
    #[arg(long, value_name = "N", default_value_t = Settings::default().landmarks_a_place as u64, value_parser = clap::value_parser!(u64).range(100..))]
    landmarks_per_place: u64,
    /// Radius of a place
    #[arg(long, value_name = "M", default_value_t = Settings::default().place_m)]
    place_m: f64,
    /// Largest angle of the optical axes of a place with that of its middle
    #[arg(long, value_name = "DEG", default_value_t = Settings::default().place_rad.to_degrees())]
    place_deg: f64,
    /// Take out an appearance that nobody has seen for so many half-lives, where another one of its place was seen
    #[arg(long, value_name = "N", default_value_t = Settings::default().unused_half_lives)]
    unused_half_lives: f64,
    /// Refuse a session that the map bends by more: ratio of the chi-square to its degrees of freedom
    #[arg(long, value_name = "RATIO", default_value_t = Settings::default().max_map_ratio)]
    max_map_ratio: f64,
}

impl SettingsArgs {
    fn read(&self) -> Result<Settings> {
        let positive = [
            ("--half-life", self.half_life),
            ("--place-m", self.place_m),
            ("--place-deg", self.place_deg),
            ("--unused-half-lives", self.unused_half_lives),
            ("--max-map-ratio", self.max_map_ratio),
        ];
        for (switch, value) in positive {
            ensure!(value.is_finite() && value > 0.0, "{switch} {value}: give a positive number");
        }
        ensure!(self.place_deg <= 180.0, "--place-deg {}: give at most 180", self.place_deg);
        let probability = self.min_existence;
        ensure!(
            probability > 0.0 && probability < 0.5,
            "--min-existence {probability}: give a probability below 0.5, which is that of a landmark of which nothing is known"
        );
        let part = self.min_added;
        ensure!((0.0..=1.0).contains(&part), "--min-added {part}: give a part, between 0 and 1");
        let mut settings = Settings::default();
        settings.half_life_days = self.half_life;
        settings.min_existence = probability;
        settings.keyframes_a_place = usize::try_from(self.keyframes_per_place)?;
        settings.min_added = part;
        settings.appearances_a_place = usize::try_from(self.appearances_per_place)?;
        settings.landmarks_a_place = usize::try_from(self.landmarks_per_place)?;
        settings.place_m = self.place_m;
        settings.place_rad = self.place_deg.to_radians();
        settings.unused_half_lives = self.unused_half_lives;
        settings.max_map_ratio = self.max_map_ratio;
        Ok(settings)
    }
}

/// Where the new version is proposed.
#[cfg(feature = "releases")]
#[derive(Clone, Debug, clap::Args)]
struct PublishingArgs {
    /// Publish the new version as a candidate: a folder, file:///..., s3://..., gs://..., az://...
    #[arg(long, value_name = "URL", conflicts_with = "dry_run")]
    to: Option<String>,
    #[command(flatten)]
    note: super::publish_map::NoteArgs,
    #[command(flatten)]
    signing: super::publish_map::SigningArgs,
}

#[cfg(feature = "releases")]
impl PublishingArgs {
    /// # Errors
    /// A key or a note that cannot be used, before hours of work; or one without a place to publish at.
    fn check(&self) -> Result<()> {
        ensure!(
            self.to.is_some() || !(self.signing.is_given() || self.note.is_given()),
            "--author, --comment and --sign are of a candidate: say with --to where it is published"
        );
        self.note.read()?;
        self.signing.check()?;
        Ok(())
    }

    /// Publishes the map as a candidate, where that is wanted and it has sessions that were never proposed.
    ///
    /// # Arguments
    /// * `sessions`: those of the map.
    fn propose(&self, map: &Path, sessions: &[SessionId], report: &mut JobReport) -> Result<Option<Outcome>> {
        let Some(to) = &self.to else { return Ok(None) };
        if report.version.is_none() && !super::publish_map::lacks_sessions(to, sessions)? {
            return Ok(None);
        }
        let outcome = super::publish_map::propose(map, to, &self.note, &self.signing)?;
        report.candidate = match &outcome {
            Outcome::Published(published) => Some(published.release.number),
            Outcome::Unchanged { .. } => None,
        };
        Ok(Some(outcome))
    }
}

/// Runs the command.
///
/// # Errors
/// A map or a path that cannot be read, a map that cannot be written or was changed meanwhile; at the end what could
/// not be remembered or proposed. A session that is refused is none.
pub fn run(args: &Args) -> Result<()> {
    let settings = args.settings.read()?;
    if let Some(inbox) = &args.inbox {
        ensure!(inbox.is_dir(), "--inbox {}: there is no such folder", inbox.display());
    }
    #[cfg(feature = "releases")]
    args.publishing.check()?;
    let interval = Duration::try_from_secs_f64(60.0 * args.save_minutes)
        .with_context(|| format!("--save-minutes {}: give minutes, or 0", args.save_minutes))?;
    let mut storage = MapStorage::new(MapTarget::new(&args.map, true)?, interval);
    let stored = load_map(&args.map)?.contents;
    let (contents, mut report, mut remembered) = work(args, &settings, stored, &mut storage)?;
    if let Some(inbox) = args.inbox.as_deref().filter(|_| args.remove_taken) {
        let (removed, all) = remove_taken(inbox, &report);
        report.removed_files = removed;
        remembered = remembered.and(all);
    }
    #[cfg(feature = "releases")]
    let candidate = {
        let sessions: Vec<SessionId> = contents.info.sessions.iter().map(|session| session.id).collect();
        args.publishing.propose(&args.map, &sessions, &mut report)
    };
    let text = serde_json::to_string_pretty(&report)?;
    if let Some(file) = &args.report {
        files::write_whole(file, text.as_bytes())
            .with_context(|| format!("{} cannot be written", file.display()))?;
    }
    if args.json {
        println!("{text}");
    } else {
        print(args, &report);
        if !report.taken.is_empty() {
            print_partial_kinds(&contents);
        }
    }
    #[cfg(feature = "releases")]
    match candidate.context("the map is not proposed as a candidate; the next run with --to makes up for it")
    {
        Ok(Some(candidate)) if !args.json => super::publish_map::print_outcome(&candidate, false)?,
        Ok(_) => {}
        Err(error) => {
            return Err(match remembered {
                Ok(()) => error,
                Err(other) => error.context(format!("{other:#}")),
            });
        }
    }
    remembered
}

/// Works the sessions in, and writes the map.
///
/// # Returns
/// The map, what was done, and whether the sessions that were refused are remembered: what was done is reported and proposed all the same.
fn work(
    args: &Args,
    settings: &Settings,
    stored: MapContents,
    storage: &mut MapStorage,
) -> Result<(MapContents, JobReport, Result<()>)> {
    let mut lines = Lines { is_quiet: args.json, work: None };
    let mut refused = RefusedSessions::read(&args.map, settings);
    let inbox = args.inbox.as_deref();
    let kept: &mut dyn Storage = if args.dry_run { &mut () } else { &mut *storage };
    let done = maintain(stored, &args.sessions, inbox, settings, &mut refused, kept, &mut lines);
    // Also where the map could not be written: the session that was worked on did not end the program.
    let remembered = if args.dry_run { Ok(()) } else { refused.write(&args.map) };
    let (mut contents, mut report) = done?;
    report.version = storage.save(&mut contents)?;
    Ok((contents, report, remembered))
}

fn print(args: &Args, report: &JobReport) {
    let JobReport { taken, refused, known, other_maps, before, after, version, .. } = report;
    println!(
        "sessions   {} taken, {} refused, {} in the map before, {} of other maps",
        taken.len(),
        refused.len(),
        known.len(),
        other_maps.len()
    );
    println!("keyframes  {} -> {}", before.keyframes, after.keyframes);
    println!("landmarks  {} -> {}", before.landmarks, after.landmarks);
    match version {
        Some(version) => println!("{}: version {version}", args.map.display()),
        None if taken.is_empty() => println!("nothing is new: nothing was written"),
        None => println!("nothing was written"),
    }
    if args.remove_taken {
        println!("inbox      {} files removed", report.removed_files.len());
    }
}

/// A line for each session, and a bar while it is worked on.
struct Lines {
    is_quiet: bool,
    work: Option<Work>,
}

/// The work on one session.
struct Work {
    bar: StageBar,
    begin: Instant,
}

impl Lines {
    /// Ends the work on a session.
    ///
    /// # Returns
    /// How long it took (s).
    fn end(&mut self) -> f64 {
        self.work.take().map_or(0.0, |work| {
            work.bar.finish();
            work.begin.elapsed().as_secs_f64()
        })
    }
}

impl Watch for Lines {
    fn begin(&mut self, file: &Path, number: usize, of: usize) {
        if !self.is_quiet {
            println!("{} ({number} of {of})", file.display());
        }
        self.work = Some(Work { bar: StageBar::new(self.is_quiet), begin: Instant::now() });
    }

    fn progress(&mut self, stage: Stage, done: usize, all: usize) {
        if let Some(work) = &mut self.work {
            work.bar.show(stage, done, all);
        }
    }

    fn taken(&mut self, session: &TakenSession) {
        let seconds = self.end();
        if self.is_quiet {
            return;
        }
        let of = &session.report;
        println!(
            "  taken, by {}: {} of {} keyframes kept",
            session.robot, of.kept_keyframes, of.session_keyframes
        );
        println!(
            "  landmarks  {} seen, {} missed, {} gone, {} beyond what their place keeps",
            of.seen,
            of.missed,
            of.gone_m.len(),
            of.surplus_landmarks
        );
        let removed = &of.removed;
        println!(
            "  keyframes  {} taken out because what they show is gone, {} replaced, {} unused",
            removed.gone, removed.replaced, removed.unused
        );
        println!("  agrees with the map: ratio {:.2} (1 is as stated); {seconds:.1} s", of.map_ratio);
    }

    fn doubtful(&mut self, session: &DoubtfulSession) {
        if !self.is_quiet {
            println!("{}: {}", session.file.display(), session.reason);
        }
    }

    fn refused(&mut self, session: &RefusedSession) {
        self.end();
        // Who reads the standard output of a night's job by a program has it in the report.
        if !self.is_quiet {
            let before = if session.before { ", as before" } else { "" };
            println!("  refused ({}{before}): {}: {}", session.kind, session.file.display(), session.reason);
        }
    }
}
