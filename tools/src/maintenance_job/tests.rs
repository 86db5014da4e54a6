//! Jobs on sessions that cannot be located: what is remembered of them, and when.

use hand_in::{Chunk, Header, RecordedSoFar, SessionFrame, SessionWriter};
use map::store::{MapTarget, load_map, save_map};
use sensors::{CameraSensor, ImuNoise, ImuSensor};
use std::time::Duration;
use testing::{Place, PlaceOptions};

use super::*;

const SECOND_NS: i64 = 1_000_000_000;
const DAY_S: i64 = 86_400;

fn map() -> MapContents {
    let mut map = Place::new(&PlaceOptions { keyframes: 8, landmarks: 60, ..PlaceOptions::default() }).map;
    map.ensure_sessions("first");
    map
}

/// A session without readings, which ends some seconds from now: its odometry fails.
fn write_session(folder: &Path, id: u8, from_now_s: i64) -> SessionId {
    let imu =
        ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    let header = Header {
        robot: "ada".to_owned(),
        name: format!("ada_{id}"),
        program: "test".to_owned(),
        started_unix_s: 0,
        imu,
        cameras: vec![CameraSensor::new(testing::camera(), geometry::Pose::identity(), 20.0)],
    };
    let end_ns = (now_unix_s() as i64 + from_now_s) * SECOND_NS;
    let frame = |stamp_ns| SessionFrame { stamp_ns, tracks: Vec::new(), candidates: Vec::new() };
    let recorded =
        RecordedSoFar { id: [id; 16], begin_ns: end_ns - SECOND_NS, end_ns, images: 2, ..Default::default() };
    let frames = vec![frame(end_ns - SECOND_NS), frame(end_ns)];
    let path = folder.join(format!("{id}.session"));
    let _ = std::fs::remove_file(&path);
    let mut writer = SessionWriter::create(&path, &header).unwrap();
    writer.append(&Chunk { recorded, frames, ..Chunk::default() }).unwrap();
    writer.finish().unwrap();
    SessionId::from_bytes([id; 16])
}

/// Which sessions were begun, and how often the file that is written before says so.
#[derive(Default)]
struct Begun {
    ids: Vec<SessionId>,
    begun: Vec<(SessionId, u32)>,
}

impl Storage for Begun {
    fn begin(&mut self, known: &RefusedSessions) {
        self.begun.extend(self.ids.iter().map(|id| (*id, known.begun(*id))).filter(|(_, count)| *count > 0));
    }

    fn taken(&mut self, _: &mut MapContents, _: &RefusedSessions) -> Result<()> {
        Ok(())
    }
}

struct Silent;

impl Watch for Silent {
    fn begin(&mut self, _: &Path, _: usize, _: usize) {}
    fn progress(&mut self, _: Stage, _: usize, _: usize) {}
    fn taken(&mut self, _: &TakenSession) {}
    fn refused(&mut self, _: &RefusedSession) {}
    fn doubtful(&mut self, _: &DoubtfulSession) {}
}

/// The kinds of the refused sessions, and whether they were refused before.
fn run(
    map: MapContents,
    folder: &Path,
    known: &mut RefusedSessions,
    storage: &mut dyn Storage,
) -> Vec<(String, bool)> {
    let (settings, paths) = (Settings::default(), [folder.to_owned()]);
    let (_, report) = maintain(map, &paths, None, &settings, known, storage, &mut Silent).unwrap();
    assert!(report.taken.is_empty() && report.known.is_empty());
    report.refused.into_iter().map(|refused| (refused.kind, refused.before)).collect()
}

fn remembered(folder: &Path) -> RefusedSessions {
    RefusedSessions::read(&folder.join("hall.db"), &Settings::default())
}

#[test]
fn a_session_of_the_future_is_never_taken_also_when_its_time_has_come() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let id = write_session(path, 1, 30 * DAY_S);
    let clock = |before| vec![("clock".to_owned(), before)];
    let mut known = remembered(path);
    assert_eq!(run(map(), path, &mut known, &mut ()), clock(false));
    // A month later.
    assert_eq!(write_session(path, 1, -DAY_S), id);
    assert_eq!(run(map(), path, &mut known, &mut ()), clock(true));
    // Where nothing is known of that night, it is as any other.
    assert_eq!(run(map(), path, &mut remembered(path), &mut ()), [("unusable".to_owned(), false)]);

    // A computer whose clock is older than the map has no word in it.
    write_session(path, 1, 30 * DAY_S);
    let mut stored = map();
    stored.info.sessions[0].added_unix_s = Some(now_unix_s() + 40 * DAY_S as u64);
    let mut known = remembered(path);
    assert_eq!(run(stored, path, &mut known, &mut ()), clock(false));
    assert_eq!(known.ahead(id), None);
}

#[test]
fn what_is_begun_is_remembered_before_and_not_begun_for_a_third_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let ids = [3, 2, 1].map(|days: u8| write_session(path, days, -DAY_S * i64::from(days)));
    let unusable = || ("unusable".to_owned(), false);
    let mut known = remembered(path);
    // The program was killed twice with the first, once with the second: that comes last.
    known.begin(ids[0]);
    known.begin(ids[0]);
    known.begin(ids[1]);
    let mut storage = Begun { ids: ids[1..].to_vec(), ..Begun::default() };
    let refused = run(map(), path, &mut known, &mut storage);
    assert_eq!(refused, [unusable(), unusable(), ("interrupted".to_owned(), true)]);
    assert_eq!(storage.begun, [(ids[1], 1), (ids[2], 1), (ids[1], 2)]);
    assert_eq!(ids.map(|id| known.begun(id)), [2, 0, 0]);
    // The next night looks at none of them.
    storage.begun.clear();
    let refused = run(map(), path, &mut known, &mut storage);
    assert!(refused.iter().all(|(_, before)| *before) && storage.begun.is_empty(), "{refused:?}");
}

#[test]
fn a_map_is_saved_when_so_much_time_has_passed_and_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    save_map(&path, &map(), false).unwrap();
    let version = || load_map(&path).unwrap().contents.info.version;
    for (interval, versions) in [(Duration::ZERO, [2, 3, 3]), (Duration::from_hours(1), [3, 3, 4])] {
        let mut storage = MapStorage::new(MapTarget::new(&path, true).unwrap(), interval);
        let mut contents = load_map(&path).unwrap().contents;
        assert_eq!(storage.save(&mut contents).unwrap(), None);
        let mut known = RefusedSessions::read(&path, &Settings::default());
        known.begin(SessionId::from_bytes([9; 16]));
        for expected in &versions[..2] {
            storage.taken(&mut contents, &known).unwrap();
            assert_eq!(version(), *expected);
        }
        // Beside the map, before it.
        assert_eq!(RefusedSessions::path(&path).exists(), interval.is_zero());
        assert_eq!(storage.save(&mut contents).unwrap(), Some(versions[2]));
        assert_eq!(version(), versions[2]);
        let _ = std::fs::remove_file(RefusedSessions::path(&path));
    }
    // What another program writes meanwhile is not overwritten.
    let mut storage = MapStorage::new(MapTarget::new(&path, true).unwrap(), Duration::ZERO);
    save_map(&path, &map(), true).unwrap();
    let known = RefusedSessions::read(&path, &Settings::default());
    let error = storage.taken(&mut map(), &known).unwrap_err().to_string();
    assert!(error.contains("changed meanwhile"), "{error}");
}
