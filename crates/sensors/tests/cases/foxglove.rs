//! Images of Foxglove's own types beside an IMU of ROS 2, as recordings of mixed robots have them.

use super::making::{IMAGES, MS, NOISE, READINGS, START_NS, chain, frames, reading};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use ros_messages::encode;
use sensors::Recording;
use sensors::ros::imu_message;
use std::collections::BTreeMap;
use std::io::BufWriter;
use std::path::Path;
use vision::GrayImage;

/// Writes a file whose images are of a type and an encoding.
fn write(path: &Path, type_name: &str, encoding: &str, image: impl Fn(i64, u8) -> Vec<u8>) {
    let mut writer = mcap::Writer::new(BufWriter::new(std::fs::File::create(path).unwrap())).unwrap();
    let mut channel = |schema: &str, schema_encoding: &str, topic: &str, encoding: &str| {
        let schema = writer.add_schema(schema, schema_encoding, b"").unwrap();
        writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
    };
    let imu = channel("sensor_msgs/msg/Imu", "ros2msg", "/imu0", "cdr");
    let camera = channel(type_name, encoding, "/camera", encoding);
    let mut put = |channel_id: u16, time_ns: i64, data: &[u8]| {
        let time = time_ns as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, data).unwrap();
    };
    for index in 0..READINGS {
        let sample = reading(index);
        put(imu, sample.stamp_ns, &encode(&imu_message(&sample, "imu").unwrap()).unwrap());
    }
    for index in 0..IMAGES {
        let stamp_ns = START_NS + index * 50 * MS;
        put(camera, stamp_ns, &image(stamp_ns, index as u8));
    }
    writer.finish().unwrap();
}

/// A field of bytes, text or a message in protobuf.
fn field(tag: u8, bytes: &[u8]) -> Vec<u8> {
    [vec![tag << 3 | 2], varint(bytes.len() as u64), bytes.to_vec()].concat()
}

fn varint(mut number: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while number > 0x7f {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

fn seconds(stamp_ns: i64) -> (u64, u64) {
    ((stamp_ns / 1_000_000_000) as u64, (stamp_ns % 1_000_000_000) as u64)
}

fn protobuf_time(stamp_ns: i64) -> Vec<u8> {
    let (whole, rest) = seconds(stamp_ns);
    field(1, &[vec![0x08], varint(whole), vec![0x10], varint(rest)].concat())
}

fn json(stamp_ns: i64, data: &[u8], rest: &str) -> Vec<u8> {
    let (whole, part) = seconds(stamp_ns);
    let data = BASE64_STANDARD.encode(data);
    format!(r#"{{"timestamp":{{"sec":{whole},"nsec":{part}}},"frame_id":"camera","data":"{data}",{rest}}}"#)
        .into_bytes()
}

/// Pixels of 8 x 6 whose first says the number of the image.
fn pixels(number: u8) -> Vec<u8> {
    let mut pixels = vec![90; 48];
    pixels[0] = number;
    pixels
}

fn png(number: u8) -> Vec<u8> {
    GrayImage::new(8, 6, pixels(number)).unwrap().to_png().unwrap()
}

#[test]
fn images_in_protobuf_and_json_are_read_as_those_of_ros() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("camchain-imucam.yaml"), chain(&["/camera"])).unwrap();
    std::fs::write(folder.path().join("imu.yaml"), NOISE).unwrap();
    let path = |name: &str| folder.path().join(name);
    let size = |tag: u8, value: u32| [vec![tag << 3 | 5], value.to_le_bytes().to_vec()].concat();
    write(&path("compressed_protobuf.mcap"), "foxglove.CompressedImage", "protobuf", |stamp_ns, number| {
        [protobuf_time(stamp_ns), field(2, &png(number)), field(3, b"png")].concat()
    });
    write(&path("raw_protobuf.mcap"), "foxglove.RawImage", "protobuf", |stamp_ns, number| {
        let sizes = [size(2, 8), size(3, 6), field(4, b"mono8"), size(5, 8)].concat();
        [protobuf_time(stamp_ns), sizes, field(6, &pixels(number))].concat()
    });
    write(&path("compressed_json.mcap"), "foxglove.CompressedImage", "json", |stamp_ns, number| {
        json(stamp_ns, &png(number), r#""format":"png""#)
    });
    write(&path("raw_json.mcap"), "foxglove.RawImage", "json", |stamp_ns, number| {
        json(stamp_ns, &pixels(number), r#""width":8,"height":6,"step":8,"encoding":"mono8""#)
    });
    for name in ["compressed_protobuf", "raw_protobuf", "compressed_json", "raw_json"] {
        let found = frames(&Recording::open(&path(&format!("{name}.mcap"))).unwrap());
        assert_eq!(found.len() as i64, IMAGES, "{name}");
        for (index, (stamp_ns, images)) in (0..).zip(&found) {
            assert_eq!((*stamp_ns, images[0]), (START_NS + index * 50 * MS, Some(index as u8)), "{name}");
        }
    }
}

#[test]
fn an_encoding_that_is_not_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("camchain-imucam.yaml"), chain(&["/camera"])).unwrap();
    std::fs::write(folder.path().join("imu.yaml"), NOISE).unwrap();
    let path = folder.path().join("flat.mcap");
    write(&path, "foxglove.RawImage", "flatbuffer", |_, number| pixels(number));
    let error = Recording::open(&path).map(|recording| frames(&recording)).unwrap_err().to_string();
    assert!(error.contains("/camera") && error.contains("flatbuffer"), "{error}");
}
