//! The pages of devices: each of their commands runs, on a bag in the form of that device.
//!
//! The bags are of one rendered flight: topics, types, encodings, frames and transforms are those that the page says of the driver.

use crate::printed::{Printed, in_blocks, root};
use geometry::camera::{Camera, Distortion};
use geometry::{Pose, Rotation};
use image::codecs::jpeg::JpegEncoder;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use ros_messages::builtin_interfaces::Time;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu};
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, encode};
use sensors::ros::{camera_info_message, transform_message};
use sensors::ros_bag::{RosBagWriter, message_type};
use sensors::{Frame, ImuSample, Sequence};
use simulation::SimulationOptions;
use simulation::images::{ImageOptions, render_all, simulate_images};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;
use vision::GrayImage;

/// How long the bags are, seconds, and their images a second.
const SECONDS: f64 = 3.0;
const RATE_HZ: f64 = 15.0;
/// Images are late by so much where nobody triggers the camera: `timeshift_cam_imu` of the page.
const LATE_NS: i64 = 12_000_000;

/// The flight, with its images in memory.
static FLIGHT: LazyLock<Sequence> = LazyLock::new(|| {
    let options =
        SimulationOptions { duration_s: Some(SECONDS), frame_rate_hz: RATE_HZ, ..ImageOptions::simulation() };
    let mut live = simulate_images(&options, &ImageOptions::default()).unwrap().live;
    render_all(&mut live, |_, _| {}).unwrap();
    live
});

/// A camera without distortion, as rectified images have it.
fn rectified() -> Camera {
    let (focal, centre, distortion) = ([215.0; 2], [159.5, 119.5], Distortion::None);
    Camera { width: 320, height: 240, focal, centre, distortion }
}

/// The images of the flight as a rectified pair sees them: those of all bags.
static RECTIFIED: LazyLock<Vec<[GrayImage; 2]>> = LazyLock::new(|| {
    let flight = &*FLIGHT;
    let sources = [0, 1].map(|camera| sources(&flight.cameras[camera].camera));
    let rectified = |frame: &Frame| {
        [0, 1].map(|camera| rectify(&frame.images[&camera].read().unwrap(), &sources[camera]))
    };
    flight.frames.iter().map(rectified).collect()
});

/// Where a pixel lies in another image: column and row of the pixel before it, and how far beyond that it is.
type Source = ([usize; 2], [f64; 2]);

/// Where a rectified camera looks in a distorted image, pixel after pixel; `None` outside of it.
fn sources(distorted: &Camera) -> Vec<Option<Source>> {
    let target = rectified();
    let source = |x: usize, y: usize| {
        let ray = target.bearing(&Vector2::new(x as f64, y as f64)).ok()?;
        let pixel = distorted.project(&ray).ok()?;
        let (left, top) = (pixel.x.floor(), pixel.y.floor());
        let is_inside = left >= 0.0 && top >= 0.0 && left < 751.0 && top < 479.0;
        is_inside.then(|| ([left as usize, top as usize], [pixel.x - left, pixel.y - top]))
    };
    (0..240).flat_map(|y| (0..320).map(move |x| source(x, y))).collect()
}

/// What a rectified camera sees, of a distorted image.
fn rectify(image: &GrayImage, sources: &[Option<Source>]) -> GrayImage {
    let sample = |([left, top], [u, v]): Source| {
        let at = |dx: usize, dy: usize| f64::from(image.get(left + dx, top + dy));
        let (upper, lower) = (at(0, 0) * (1.0 - u) + at(1, 0) * u, at(0, 1) * (1.0 - u) + at(1, 1) * u);
        (upper * (1.0 - v) + lower * v).round() as u8
    };
    GrayImage::from_fn(320, 240, |x, y| sources[320 * y + x].map(sample).unwrap_or_default())
}

/// The messages of an IMU.
enum ImuTopics {
    /// One topic, and the frame.
    United(&'static str, &'static str),
    /// Gyroscope and accelerometer, and their frames.
    Split([&'static str; 2], [&'static str; 2]),
}

/// What a driver publishes of a calibrated pair.
struct StereoDriver {
    /// The topics of the images, left and right, and their frames.
    cameras: [(&'static str, &'static str); 2],
    encoding: &'static str,
    imu: ImuTopics,
    /// A further topic of the same IMU, raw.
    raw_imu: Option<&'static str>,
    /// Whether `CameraInfo` states the lens beside the rectified projection.
    states_lens: bool,
    /// The frame that holds all others.
    base: &'static str,
}

const D435I: StereoDriver = StereoDriver {
    cameras: [
        ("/camera/camera/infra1/image_rect_raw", "camera_infra1_optical_frame"),
        ("/camera/camera/infra2/image_rect_raw", "camera_infra2_optical_frame"),
    ],
    encoding: "mono8",
    imu: ImuTopics::Split(
        ["/camera/camera/gyro/sample", "/camera/camera/accel/sample"],
        ["camera_gyro_optical_frame", "camera_accel_optical_frame"],
    ),
    raw_imu: None,
    states_lens: false,
    base: "camera_link",
};
const D455: StereoDriver =
    StereoDriver { imu: ImuTopics::United("/camera/camera/imu", "camera_imu_optical_frame"), ..D435I };
const OAK: StereoDriver = StereoDriver {
    cameras: [
        ("/oak/left/image_rect", "oak_left_camera_optical_frame"),
        ("/oak/right/image_rect", "oak_right_camera_optical_frame"),
    ],
    encoding: "mono8",
    imu: ImuTopics::United("/oak/imu/data", "oak_imu_frame"),
    raw_imu: None,
    states_lens: true,
    base: "oak",
};
const ZED: StereoDriver = StereoDriver {
    cameras: [
        ("/zed/zed_node/left_gray/image_rect_gray", "zed_left_camera_optical_frame"),
        ("/zed/zed_node/right_gray/image_rect_gray", "zed_right_camera_optical_frame"),
    ],
    encoding: "mono8",
    imu: ImuTopics::United("/zed/zed_node/imu/data", "zed_imu_link"),
    raw_imu: Some("/zed/zed_node/imu/data_raw"),
    states_lens: false,
    base: "zed_camera_link",
};

/// A bag that is written in order of time.
#[derive(Default)]
struct Messages {
    all: Vec<(i64, String, bags::MessageType, Vec<u8>)>,
}

impl Messages {
    fn add<M: RosMessage>(&mut self, topic: &str, stamp_ns: i64, message: &M) {
        self.all.push((stamp_ns, topic.to_owned(), message_type::<M>(), encode(message).unwrap()));
    }

    fn write(mut self, path: &Path) {
        self.all.sort_by_key(|(stamp_ns, ..)| *stamp_ns);
        let mut bag = RosBagWriter::create(path, bags::Format::Mcap).unwrap();
        for (stamp_ns, topic, of, bytes) in self.all {
            bag.write(&topic, || of, stamp_ns, &bytes).unwrap();
        }
        bag.finish().unwrap();
    }

    /// A reading in the axes of another frame; a driver of one of the sensors leaves the other's values zero.
    fn imu(&mut self, (topic, frame): (&str, &str), sample: &ImuSample, axes: &Rotation, parts: [bool; 2]) {
        let turned = |vector: &Vector3<f64>, is_there: bool| -> [f64; 3] {
            if is_there { (axes.inverse() * vector).into() } else { [0.0; 3] }
        };
        let message = Imu {
            header: Header::new(sample.stamp_ns, frame).unwrap(),
            angular_velocity: turned(&sample.gyroscope, parts[0]).into(),
            linear_acceleration: turned(&sample.accelerometer, parts[1]).into(),
            ..Imu::default()
        };
        self.add(topic, sample.stamp_ns, &message);
    }
}

/// x right, y down, z forward in x forward, y left, z up.
fn optical() -> Rotation {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

impl StereoDriver {
    fn record(&self, path: &Path) {
        let flight = &*FLIGHT;
        let mut messages = Messages::default();
        let start_ns = flight.imu_samples[0].stamp_ns;
        let stamp = Time::from_nanoseconds(start_ns).unwrap();
        // Where the body is in the frame of the base: somewhere.
        let base_from_body =
            Pose::new(UnitQuaternion::from_euler_angles(0.02, -0.03, 0.1), Vector3::new(0.01, -0.02, 0.005));
        let mut transforms = Vec::new();
        for (camera, (_, frame)) in flight.cameras.iter().zip(&self.cameras) {
            let link = frame.replace("_optical", "");
            let base_from_camera = base_from_body * camera.imu_from_camera;
            let to_link =
                Pose::new(base_from_camera.rotation * optical().inverse(), base_from_camera.translation);
            transforms.push(transform_message(stamp, self.base, &link, &to_link));
            let to_optical = Pose::new(optical(), Vector3::zeros());
            transforms.push(transform_message(stamp, &link, frame, &to_optical));
        }
        let imu_frames: &[&str] = match &self.imu {
            ImuTopics::United(_, frame) => &[frame],
            ImuTopics::Split(_, frames) => frames,
        };
        let axes = optical();
        for frame in imu_frames {
            let mounted = base_from_body * Pose::new(axes, Vector3::zeros());
            transforms.push(transform_message(stamp, self.base, frame, &mounted));
        }
        messages.add("/tf_static", start_ns, &TFMessage { transforms });
        for (index, sample) in flight.imu_samples.iter().enumerate() {
            match &self.imu {
                ImuTopics::United(topic, frame) => {
                    for topic in std::iter::once(topic).chain(&self.raw_imu) {
                        messages.imu((topic, frame), sample, &axes, [true, true]);
                    }
                }
                ImuTopics::Split(topics, frames) => {
                    messages.imu((topics[0], frames[0]), sample, &axes, [true, false]);
                    // Half as often, and between the readings of the gyroscope.
                    if index % 2 == 0 && index > 0 {
                        let before = &flight.imu_samples[index - 1];
                        let between = ImuSample {
                            stamp_ns: i64::midpoint(before.stamp_ns, sample.stamp_ns),
                            accelerometer: (before.accelerometer + sample.accelerometer) / 2.0,
                            ..*sample
                        };
                        messages.imu((topics[1], frames[1]), &between, &axes, [false, true]);
                    }
                }
            }
        }
        for (frame, rectified_pair) in flight.frames.iter().zip(&*RECTIFIED) {
            for (camera, (topic, name)) in self.cameras.iter().enumerate() {
                let seen = &rectified_pair[camera];
                let header = Header::new(frame.stamp_ns, name).unwrap();
                let mut info = camera_info_message(&rectified(), header.clone());
                if self.states_lens {
                    let lens = [-4.2, 12.1, 0.001, -0.002, 9.3, -4.3, 12.4, 8.9];
                    (info.distortion_model, info.d) = ("rational_polynomial".to_owned(), lens.to_vec());
                    (info.k[0], info.k[4]) = (231.0, 231.0);
                }
                let namespace = topic.rsplit_once('/').unwrap().0;
                messages.add(&format!("{namespace}/camera_info"), frame.stamp_ns, &info);
                let image = Image {
                    header,
                    height: 240,
                    width: 320,
                    encoding: self.encoding.to_owned(),
                    is_bigendian: 0,
                    step: 320,
                    data: seen.pixels().to_vec(),
                };
                messages.add(topic, frame.stamp_ns, &image);
            }
        }
        messages.write(path);
    }
}

/// A camera that nobody triggers: JPEG, late by some milliseconds, without projection and transforms.
fn record_usb_camera(path: &Path) {
    let flight = &*FLIGHT;
    let mut messages = Messages::default();
    for sample in &flight.imu_samples {
        messages.imu(("/imu/data", "imu_link"), sample, &Rotation::identity(), [true, true]);
    }
    for frame in &flight.frames {
        let seen = frame.images[&0].read().unwrap();
        let mut data = Vec::new();
        JpegEncoder::new_with_quality(&mut data, 92)
            .encode(seen.pixels(), 752, 480, image::ExtendedColorType::L8)
            .unwrap();
        let stamp_ns = frame.stamp_ns - LATE_NS;
        let header = Header::new(stamp_ns, "camera").unwrap();
        let image = CompressedImage { header, format: "rgb8; jpeg compressed bgr8".to_owned(), data };
        messages.add("/image_raw/compressed", stamp_ns, &image);
    }
    messages.write(path);
}

/// The files that a page prints: blocks of YAML that begin with their name.
fn files_of(text: &str) -> Vec<(String, String)> {
    let blocks = text.split("```yaml\n").skip(1).filter_map(|rest| rest.split("```").next());
    let named = |block: &str| {
        let (first, _) = block.split_once('\n')?;
        Some((first.strip_prefix("# ")?.to_owned(), block.to_owned()))
    };
    blocks.filter_map(named).collect()
}

/// The name of a bag, and how it is recorded.
type Bag<'a> = (&'a str, &'a dyn Fn(&Path));

/// Runs the commands of a page that name one of the bags, in order, beside the files that it prints.
fn run_page(page: &str, bags: &[Bag<'_>]) {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for (name, record) in bags {
        record(&folder.path().join(name));
    }
    let printed = in_blocks(page, &text);
    let is_of_bag = |printed: &&Printed| {
        let names_bag = printed.words.iter().any(|word| bags.iter().any(|(bag, _)| word == bag));
        printed.words[0] == "driftless" && names_bag
    };
    let commands: Vec<&Printed> = printed.iter().filter(is_of_bag).collect();
    let is_used = |file: &str| commands.iter().any(|command| command.words.iter().any(|word| word == file));
    for (name, content) in files_of(&text).into_iter().filter(|(name, _)| is_used(name)) {
        // The renderer exposes all rows together.
        let content = content.replace("line_delay: 3.0e-5", "line_delay: 0.0");
        fs::write(folder.path().join(name), content).unwrap();
    }
    let mut runs = 0;
    for Printed { line, words, .. } in commands {
        let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
        let output = command.args(&words[1..]).current_dir(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        let at = format!("{page}:{line}: {}\n{said}", words.join(" "));
        println!("{at}");
        assert!(output.status.success(), "{at}");
        assert!(!said.contains("ALARM"), "{at}");
        let Some(out) = words.iter().position(|word| word == "--out") else { continue };
        let summary = fs::read_to_string(folder.path().join(&words[out + 1]).join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        let frames = summary["frames"].as_u64().unwrap();
        assert!(frames as f64 > 0.5 * SECONDS * RATE_HZ, "{at}\n{summary:#}");
        runs += 1;
    }
    assert_eq!(runs, bags.len(), "{page} runs each of its bags");
}

/// One test, since all bags are of one flight, which takes longer to render than a page to run.
#[test]
fn the_pages_of_all_devices_run_as_they_are_printed() {
    let realsense: [Bag<'_>; 2] =
        [("d435i.mcap", &|path| D435I.record(path)), ("d455.mcap", &|path| D455.record(path))];
    run_page("docs/src/devices/realsense.md", &realsense);
    run_page("docs/src/devices/oak-d.md", &[("oak.mcap", &|path| OAK.record(path))]);
    run_page("docs/src/devices/zed.md", &[("zed.mcap", &|path| ZED.record(path))]);
    run_page("docs/src/devices/usb-camera.md", &[("usb.mcap", &|path| record_usb_camera(path))]);
}
