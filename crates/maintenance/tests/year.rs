//! A simulated year of a place: robots hand in sessions, landmarks are moved, and the map stays true and of its size.

use geometry::Pose;
use maintenance::{Refusal, SessionReport, Settings, take_session};
use map::MapContents;
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, run_odometry};
use nalgebra::Vector3;
use sensors::Sequence;
use simulation::{ChangingPlace, Scenario, SimulationOptions};

use crate::nees::Truth;

const FIRST_NS: i64 = 1_700_000_000_000_000_000;
const YEAR_NS: i64 = 365 * 86_400_000_000_000;
/// Part of the landmarks that are moved within the year.
const MOVED: f64 = 0.3;
/// A landmark of the map and one of the world that are this near are the same (m).
const NEAR_M: f64 = 0.1;

fn options(seed: u64) -> SimulationOptions {
    SimulationOptions {
        seed,
        scenario: Scenario::Room,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(12.0),
        landmarks_per_metre: 6.0,
        repeated_texture: 0.0,
        max_tracks: 60,
        max_features: 150,
        live_feature_period_s: 1.0,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    }
}

fn settings() -> Settings {
    let mut settings = Settings::default();
    // Enough keyframes for NEES to be told: the room is small.
    (settings.place_m, settings.place_rad) = (0.7, 30_f64.to_radians());
    settings
}

fn build(sequence: &mut Sequence) -> MapContents {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    let mut options = BuildOptions::default();
    options.sigma_px = None;
    let none = PosePriors::default();
    build_map_from_odometry(sequence, &odometry, &none, None, &options, &mut |_, _, _| {}).unwrap().0
}

fn take(map: &MapContents, session: &Sequence) -> Result<(MapContents, SessionReport), Refusal> {
    let mut map = map.clone();
    let report = take_session(
        &mut map,
        &mut session.clone(),
        &BuildOptions::default(),
        &settings(),
        &mut |_, _, _| {},
    )?;
    Ok((map, report))
}

/// The calibration of another robot: lenses that are 3 % longer.
fn with_wrong_calibration(mut session: Sequence) -> Sequence {
    for sensor in &mut session.cameras {
        sensor.camera.focal = sensor.camera.focal.map(|focal| 1.03 * focal);
    }
    session
}

/// How many of some positions in G are where a landmark of the world is.
fn still_there(place: &ChangingPlace, world_from_global: &Pose, gone_m: &[[f64; 3]]) -> usize {
    let is_there = |position: &&[f64; 3]| {
        let position = world_from_global.transform(&Vector3::from(**position));
        place.landmark_positions().any(|landmark| (landmark - position).norm() < NEAR_M)
    };
    gone_m.iter().filter(is_there).count()
}

/// Sessions of a year, and what became of them.
struct Year {
    place: ChangingPlace,
    elsewhere: ChangingPlace,
    map: MapContents,
    sessions: u64,
    /// Landmarks that were taken out, and those of them that were still there.
    gone: [usize; 2],
    /// Keyframes and landmarks after each session.
    sizes: Vec<[usize; 2]>,
}

impl Year {
    fn begin_ns(&self, session: u64) -> i64 {
        FIRST_NS + YEAR_NS / self.sessions as i64 * session as i64
    }

    /// Three sessions that must not be taken: with a wrong calibration, handed in twice, of another place.
    fn hand_in_bad_ones(&self, session: u64, last: &Sequence) {
        let begin_ns = self.begin_ns(session) + 1_000_000_000_000;
        let wrong = with_wrong_calibration(self.place.record(10_000 + session, begin_ns).unwrap());
        let refusal = take(&self.map, &wrong).unwrap_err();
        println!("wrong calibration: {refusal}");
        assert_eq!(refusal.kind(), "contradiction");
        let refusal = take(&self.map, last).unwrap_err();
        println!("again: {refusal}");
        assert_eq!(refusal.kind(), "twice");
        let refusal = take(&self.map, &self.elsewhere.record(session, begin_ns).unwrap()).unwrap_err();
        println!("elsewhere: {refusal}");
        assert_eq!(refusal.kind(), "other-place");
    }
}

/// Lives a year of so many sessions, with bad ones among them.
///
/// # Arguments
/// * `lived`: the sessions that are lived.
/// * `bad_after`: the sessions after which bad ones are handed in.
fn live(seed: u64, sessions: u64, lived: u64, bad_after: &[u64]) -> Year {
    let place = ChangingPlace::new(&options(seed)).unwrap();
    let mut first = place.record(100_000, FIRST_NS).unwrap();
    let mut truth = Truth::default();
    truth.add(&first);
    let map = build(&mut first);
    let global_from_world = truth.global_from_world(&map);
    let world_from_global = global_from_world.inverse();
    let elsewhere = ChangingPlace::new(&options(seed + 1000)).unwrap();
    let mut year = Year { place, elsewhere, map, sessions, gone: [0; 2], sizes: Vec::new() };
    for session in 1..=lived {
        year.place.move_landmarks(1.0 - (1.0 - MOVED).powf(1.0 / sessions as f64), session);
        let recorded = year.place.record(session, year.begin_ns(session)).unwrap();
        truth.add(&recorded);
        let (map, report) = take(&year.map, &recorded).unwrap();
        year.map = map;
        year.gone[0] += report.gone_m.len();
        year.gone[1] += still_there(&year.place, &world_from_global, &report.gone_m);
        year.sizes.push([report.keyframes, report.landmarks]);
        let [nees, error_m] = truth.nees(&year.map, &global_from_world);
        println!("{session}: NEES {nees:.2}, {error_m:.4} m, {report:.2?}");
        assert!((0.8..1.3).contains(&nees), "session {session}: NEES {nees}");
        assert_eq!(year.map.audit_sessions(), Vec::new());
        assert_eq!(year.map.info.sessions.len() as u64, 1 + session);
        if bad_after.contains(&session) {
            year.hand_in_bad_ones(session, &recorded);
        }
    }
    println!("{} landmarks were taken out, {} of them were still there", year.gone[0], year.gone[1]);
    year
}

#[test]
fn a_short_year_keeps_the_map_true_and_refuses_bad_sessions() {
    let year = live(1, 5, 5, &[3]);
    assert!(year.gone[0] > 10, "{:?}", year.gone);
    assert!(year.gone[1] * 4 < year.gone[0], "{:?}", year.gone);
}

/// In the second session of this draw the step of one landmark is never lower: it kept the whole session 19 mm off, at 2 mm claimed.
#[test]
fn a_landmark_that_goes_astray_keeps_no_session_where_it_began() {
    live(7, 6, 2, &[]);
}

#[test]
#[ignore = "takes minutes"]
fn a_year_keeps_the_map_true_of_its_size_and_refuses_bad_sessions() {
    let year = live(1, 100, 100, &[20, 60, 100]);
    // By then robots have come to most views.
    let settled = &year.sizes[year.sizes.len() / 2..];
    for of in 0..2 {
        let least = settled.iter().map(|size| size[of]).min().unwrap();
        let most = settled.iter().map(|size| size[of]).max().unwrap();
        println!("{least} to {most} {}", ["keyframes", "landmarks"][of]);
        assert!(most as f64 <= 1.1 * least as f64, "{least} to {most}");
    }
    // What was moved is taken out, and little else.
    assert!(year.gone[1] * 10 < year.gone[0], "{:?}", year.gone);
}
