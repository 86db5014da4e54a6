//! Inputs and source on threads of their own.

use super::*;
use crate::live::{LiveFrames, LiveSource};
use crate::{SensorEvent, SensorSource, TrackObservation};
use nalgebra::Vector2;

#[test]
fn what_drivers_hand_in_on_their_threads_comes_out_decoded() {
    let calibration = calibration(1);
    let settings = LiveSettings { max_waiting_frames: 1000, ..LiveSettings::images(&calibration) };
    let (inputs, mut source) = LiveSource::new("test", calibration, &settings);
    let readings = source.tap_imu().unwrap();
    let driver = std::thread::spawn(move || {
        for (_, message) in on_time(1, 2) {
            match message {
                Message::Imu(reading) => inputs.imu(reading),
                Message::Image(camera, stamp_ns, image) => inputs.image(camera, stamp_ns, image),
                Message::Wheels(_) | Message::Gnss(_) | Message::NoFix => unreachable!("there are none"),
            }
        }
        let last_ns = START_NS + 2 * SECOND;
        inputs.image(0, last_ns, LiveImage::Gray(GrayImage::from_fn(9, 6, |_, _| 0)));
        inputs.imu(reading(last_ns));
        inputs.refuse(Stream::Camera(0), "the encoding is yuv422");
        inputs.close();
    });
    driver.join().unwrap();
    let (mut imu, mut frames) = (Vec::new(), 0);
    while let Some(event) = source.next().unwrap() {
        match event {
            SensorEvent::Imu(reading) => imu.push(reading),
            SensorEvent::Frame(frame) => {
                assert!(imu.last().unwrap().stamp_ns <= frame.stamp_ns);
                assert_eq!(frame.images[&0].read().unwrap().width(), SIZE.0);
                frames += 1;
            }
            SensorEvent::Wheels(_) | SensorEvent::Gnss(_) => unreachable!("there are none"),
            SensorEvent::Tick => {}
        }
    }
    assert_eq!((imu.len(), frames), (401, 40));
    assert_eq!(readings.try_iter().collect::<Vec<_>>(), imu);
    let faults = source.live().unwrap().faults;
    let of_camera: Vec<String> = faults.iter().map(ToString::to_string).collect();
    assert!(
        of_camera.iter().any(|text| text.starts_with("cam0:") && text.contains("9 x 6")),
        "{of_camera:?}"
    );
}

#[test]
fn tracks_come_with_their_features_and_ticks_where_nothing_comes() {
    let mut settings = LiveSettings::images(&calibration(2));
    settings.frames = LiveFrames::Tracks { features: true };
    let (inputs, mut source) = LiveSource::new("test", calibration(2), &settings);
    assert!(source.contents().tracks && source.contents().features && !source.contents().images);
    assert_eq!(source.next().unwrap(), Some(SensorEvent::Tick));
    let track = TrackObservation { camera: 1, feature_id: 7, pixel: Vector2::new(1.0, 2.0) };
    inputs.tracks(START_NS, vec![track], None);
    inputs.imu(reading(START_NS));
    inputs.close();
    let events: Vec<SensorEvent> = std::iter::from_fn(|| source.next().unwrap()).collect();
    assert!(
        matches!(&events[..], [SensorEvent::Imu(_), SensorEvent::Frame(frame)] if frame.tracks == [track])
    );
}
