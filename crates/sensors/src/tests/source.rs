//! Laws of sensor sources.

use super::*;
use vision::GrayImage;

fn events(mut source: impl SensorSource) -> Vec<SensorEvent> {
    let events = std::iter::from_fn(|| source.next().unwrap()).collect();
    assert_eq!(source.next().unwrap(), None, "the end stays the end");
    events
}

#[test]
fn a_source_returns_everything_in_order_of_time_and_readings_before_frames() {
    for seed in 0..4 {
        let sequence = sequence(seed);
        let events = events(Recording::from(&sequence).source().unwrap());
        assert!(events.is_sorted_by_key(SensorEvent::stamp_ns));
        let (mut readings, mut wheels, mut frames) = (Vec::new(), Vec::new(), Vec::new());
        let mut gnss = Vec::new();
        for event in events {
            match event {
                SensorEvent::Imu(reading) => {
                    // START_NS is the time of the first reading and of the first frame.
                    assert!(!frames.is_empty() || reading.stamp_ns == START_NS);
                    readings.push(reading);
                }
                SensorEvent::Wheels(reading) => wheels.push(reading),
                SensorEvent::Gnss(reading) => gnss.push(reading),
                SensorEvent::Frame(frame) => {
                    assert!(readings.last().unwrap().stamp_ns <= frame.stamp_ns);
                    frames.push(frame);
                }
                SensorEvent::Tick => unreachable!("a recording has no ticks"),
            }
        }
        assert_eq!((readings, frames), (sequence.imu_samples, sequence.frames));
        assert_eq!(wheels, sequence.wheel_readings);
        assert_eq!(gnss, sequence.gnss_readings);
    }
}

#[test]
fn a_recording_in_memory_and_one_on_disk_are_the_same_source() {
    let written = sequence(2);
    let folder = tempfile::tempdir().unwrap();
    writer::write(&written, folder.path()).unwrap();
    let (disk, memory) = (Recording::open(folder.path()).unwrap(), Recording::from(&written));
    assert_eq!(disk.contents(), memory.contents());
    assert_eq!(disk.calibration().imu, memory.calibration().imu);
    assert_eq!(events(disk.source().unwrap()), events(memory.source().unwrap()));
    let second = START_NS + 100_000_001;
    let (disk, memory) = (disk.between(second, i64::MAX), memory.between(second, i64::MAX));
    let excerpt = events(disk.source().unwrap());
    assert_eq!(excerpt, events(memory.source().unwrap()));
    let frames = excerpt.iter().filter(|event| matches!(event, SensorEvent::Frame(_)));
    assert_eq!(frames.count(), written.frames.len() - 1);
}

#[test]
fn gnss_is_read_in_latitude_and_longitude_where_an_origin_is_stated() {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(2), folder.path()).unwrap();
    let (data, yaml) =
        (folder.path().join("mav0/gnss0/data.csv"), folder.path().join("mav0/gnss0/sensor.yaml"));
    std::fs::write(&yaml, "antenna: [0.1, 0.2, 0.9]\norigin: [48.0, 11.0, 500.0]\nnoise: [0.5, 0.5, 1.0]\n")
        .unwrap();
    std::fs::write(&data, format!("#ns,latitude,longitude,altitude\n{START_NS},48.001,11.0,501.0\n"))
        .unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert!(recording.contents().gnss);
    let reading = recording.gnss_readings().unwrap().next().unwrap().unwrap();
    assert!((reading.position - Vector3::new(0.0, 111.2, 1.0)).norm() < 0.1, "{}", reading.position);
    assert_eq!(reading.covariance.diagonal(), Vector3::new(0.25, 0.25, 1.0));
    for (row, word) in
        [("11.0,48.001,501", "order of latitude"), ("500,11,501", "no latitude"), ("48,11", "column")]
    {
        std::fs::write(&data, format!("#ns\n{START_NS},{row}\n")).unwrap();
        let error = Recording::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains("gnss0") && error.contains(word), "{error}");
    }
    std::fs::write(&data, format!("{START_NS},1,2,3\n")).unwrap();
    std::fs::write(&yaml, "antenna: [0.1, 0.2, 0.9]\n").unwrap();
    let error = Recording::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("standard deviations"), "{error}");
    std::fs::write(&yaml, "antenna: [0.1, 0.2, 0.9]\norigin: [148.0, 11.0, 500.0]\n").unwrap();
    assert!(Recording::open(folder.path()).unwrap_err().to_string().contains("origin"));
}

#[test]
fn wheels_without_geometry_are_read_and_wrong_ones_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(2), folder.path()).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert!(recording.contents().wheels.is_some() && recording.calibration().wheels.is_some());
    let wheels = folder.path().join("mav0/wheels0");
    let yaml = std::fs::read_to_string(wheels.join("sensor.yaml")).unwrap();
    std::fs::write(wheels.join("sensor.yaml"), yaml.replace("track: 0.5", "track: -0.5")).unwrap();
    assert!(Recording::open(folder.path()).unwrap_err().to_string().contains("track"));
    std::fs::remove_file(wheels.join("sensor.yaml")).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert!(recording.contents().wheels.is_some() && recording.calibration().wheels.is_none());
    let table = std::fs::read_to_string(wheels.join("data.csv")).unwrap();
    let cut = table.trim_end().rfind(',').unwrap();
    std::fs::write(wheels.join("data.csv"), table[..cut].to_owned() + ",nan\n").unwrap();
    assert!(Recording::open(folder.path()).unwrap_err().to_string().contains("wheels0"));
}

#[test]
fn a_file_that_is_damaged_after_it_was_checked_ends_the_source_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(1), folder.path()).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    let path = folder.path().join("mav0/imu0/data.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, &text[..text.trim_end().rfind(',').unwrap()]).unwrap();
    let mut source = recording.source().unwrap();
    let error = loop {
        match source.next() {
            Ok(event) => assert!(event.is_some(), "the damage was not found"),
            Err(error) => break error,
        }
    };
    assert!(matches!(error, SensorError::Recording(SequenceError::Row { .. })), "{error}");
    assert_eq!(source.next().unwrap(), None);
}

#[test]
fn an_image_is_the_same_from_a_file_and_from_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.png");
    let image = GrayImage::from_fn(8, 6, |x, y| (16 * y + x) as u8);
    image.write(&path).unwrap();
    assert_eq!(ImageData::from(path).read().unwrap(), ImageData::from(image).read().unwrap());
    assert!(ImageData::from(folder.path().join("missing.png")).read().is_err());
}
