//! Images of two cameras that are not stamped alike.

use super::making::{IMAGES, MS, Made, START_NS, frames, messages};
use sensors::{CalibrationFiles, PairCounts, SensorSource, Sequence, writer};

const CAMERAS: [&str; 2] = ["/cam0/image_raw", "/cam1/image_raw"];

/// What is done to the stamps of camera 1, by the number of the image; `None` where it is missing.
type Second = fn(i64) -> Option<i64>;

/// Pairs, lone images of camera 0 and of camera 1.
fn counts(pairs: PairCounts) -> (usize, usize, usize) {
    (pairs.pairs, pairs.lone_first, pairs.lone_second)
}

const CASES: [(&str, Second, (usize, usize, usize)); 6] = [
    ("the same stamps", |_| Some(0), (40, 0, 0)),
    ("3 ms late", |_| Some(3 * MS), (40, 0, 0)),
    ("early and late by 2 ms", |k| Some((k % 5 - 2) * MS), (40, 0, 0)),
    ("200 ns early", |_| Some(-200), (40, 0, 0)),
    ("half of them", |k| (k % 2 == 0).then_some(0), (20, 20, 0)),
    ("a tenth 20 ms late", |k| Some(if k % 10 == 3 { 20 * MS } else { 0 }), (36, 4, 4)),
];

#[test]
fn images_of_a_bag_pair_with_the_nearest_and_are_counted() {
    for (name, second, expected) in CASES {
        let mut all = messages(2);
        let mut index = 0;
        all.retain_mut(|message| {
            if message.topic != CAMERAS[1] {
                return true;
            }
            index += 1;
            let by_ns = second(index - 1);
            message.shift(by_ns.unwrap_or(0));
            by_ns.is_some()
        });
        let made = Made::new(&all, &CAMERAS);
        let recording = made.open().unwrap();
        assert_eq!(counts(recording.stereo_pairs().unwrap()), expected, "{name}");
        assert_eq!(recording.source().unwrap().stereo_pairs(), recording.stereo_pairs(), "{name}");
        let frames = frames(&recording);
        assert_eq!(frames.len(), IMAGES as usize, "{name}");
        for (index, (stamp_ns, [first, partner])) in frames.into_iter().enumerate() {
            assert_eq!((stamp_ns, first), (START_NS + index as i64 * 50 * MS, Some(index as u8)), "{name}");
            assert!(partner.is_none() || partner == first, "{name}");
        }
    }
}

#[test]
fn images_of_a_folder_pair_in_the_same_way_and_their_tracks_with_them() {
    let control = Made::new(&messages(2), &CAMERAS);
    let mut sequence = Sequence::open(&control.path).unwrap();
    for (index, frame) in sequence.frames.iter_mut().enumerate() {
        frame.images.clear();
        let track = |camera| sensors::TrackObservation {
            camera,
            feature_id: index as u64,
            pixel: nalgebra::Vector2::new(1.0, 2.0),
        };
        frame.tracks = vec![track(0), track(1)];
    }
    for (name, second, expected) in CASES {
        let folder = tempfile::tempdir().unwrap();
        writer::write(&sequence, folder.path()).unwrap();
        for table in ["data.csv", "tracks.csv"] {
            let path = folder.path().join("mav0/cam1").join(table);
            let text = std::fs::read_to_string(&path).unwrap();
            let row = |line: &str| {
                let (stamp, rest) = line.split_once(',').unwrap();
                let Ok(stamp) = stamp.parse::<i64>() else { return Some(format!("{line}\n")) };
                let by_ns = second((stamp - START_NS) / (50 * MS))?;
                Some(format!("{},{rest}\n", stamp + by_ns))
            };
            std::fs::write(&path, text.lines().filter_map(row).collect::<String>()).unwrap();
        }
        let read = Sequence::open(folder.path()).unwrap();
        let recording = sensors::Recording::open(folder.path()).unwrap();
        assert_eq!(counts(recording.stereo_pairs().unwrap()), expected, "{name}");
        assert_eq!(read.frames.len(), IMAGES as usize, "{name}");
        for (index, frame) in read.frames.iter().enumerate() {
            assert_eq!(frame.stamp_ns, sequence.frames[index].stamp_ns, "{name}");
            assert!(frame.tracks.iter().all(|track| track.feature_id == index as u64), "{name}");
        }
        let paired = read.frames.iter().filter(|frame| frame.tracks.len() == 2).count();
        assert_eq!(paired, expected.0, "{name}");
    }
}

#[test]
fn the_tolerance_can_be_changed() {
    let mut all = messages(2);
    all.iter_mut().filter(|message| message.topic == CAMERAS[1]).for_each(|message| message.shift(8 * MS));
    let made = Made::new(&all, &CAMERAS);
    for (tolerance_ms, expected) in [(None, (0, 40, 40)), (Some(7), (0, 40, 40)), (Some(8), (40, 0, 0))] {
        let mut files = CalibrationFiles::default();
        files.pair_tolerance_ns = tolerance_ms.map(|ms| ms * MS);
        let recording = made.open_with(&files).unwrap();
        let pairs = recording.stereo_pairs().unwrap();
        assert_eq!(counts(pairs), expected, "{tolerance_ms:?}");
        let largest_ms = if expected.0 > 0 { 8 } else { 0 };
        assert_eq!(pairs.largest_difference_ns, largest_ms * MS);
    }
    assert_eq!(Made::new(&messages(1), &CAMERAS[..1]).open().unwrap().stereo_pairs(), None);
}
