//! ROS 1 messages against the same messages in CDR, both serialized by Python's rosbags (`crates/bags/tests/data/make.py`).

use bags::Bag;
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu};
use ros_messages::{RosMessage, decode, ros1};
use std::fmt::Debug;
use std::path::Path;

fn open(name: &str) -> Bag {
    Bag::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../bags/tests/data").join(name)).unwrap()
}

fn messages_of<M: RosMessage>(bag: &Bag) -> Vec<Vec<u8>> {
    let name = M::TYPE_NAME.replace("/msg/", "/");
    let topics = bag.topics().iter().filter(|topic| topic.type_name == name);
    topics.flat_map(|topic| &topic.messages).map(|message| bag.read(message.place).unwrap()).collect()
}

fn assert_same<M: RosMessage + PartialEq + Debug>(one: &Bag, two: &Bag) {
    let (one, two) = (messages_of::<M>(one), messages_of::<M>(two));
    assert!(!one.is_empty() && one.len() == two.len());
    for (ros1, cdr) in one.iter().zip(&two) {
        assert_eq!(ros1::decode::<M>(ros1).unwrap(), decode::<M>(cdr).unwrap());
        assert!(ros1::decode::<M>(cdr).is_err(), "CDR is not taken for ROS 1");
        for end in (0..ros1.len()).step_by(7) {
            assert!(ros1::decode::<M>(&ros1[..end]).is_err(), "{end} of {} bytes", ros1.len());
        }
    }
}

#[test]
fn the_same_messages_in_both_encodings_are_equal() {
    let (one, two) = (open("excerpt.bag"), open("excerpt_mcap"));
    assert_same::<Imu>(&one, &two);
    assert_same::<Image>(&one, &two);
    assert_same::<CompressedImage>(&one, &two);
    assert_same::<CameraInfo>(&one, &two);
}

#[test]
fn a_length_beyond_the_message_allocates_nothing() {
    let image = Bag::read(&open("excerpt.bag"), open("excerpt.bag").topics()[1].messages[0].place).unwrap();
    let data = image.len() - 94 * 60;
    let mut damaged = image;
    damaged[data - 4..data].fill(0xff);
    assert!(ros1::decode::<Image>(&damaged).is_err());
}
