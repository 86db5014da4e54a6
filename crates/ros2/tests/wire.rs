//! Keys, tokens, ids and attachments, written out by hand from the sources of rmw_zenoh.

use ros_messages::RosMessage;
use ros_messages::nav_msgs::Odometry;
use ros2::liveliness::{Endpoint, NodeIdentity, TopicIdentity, gid};
use ros2::names::data_key;
use ros2::{Attachment, Qos};

const HASH: &str = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";

fn node(namespace: &str) -> NodeIdentity {
    NodeIdentity {
        domain: 7,
        session: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(),
        number: 0,
        namespace: namespace.to_owned(),
        name: "driftless".to_owned(),
    }
}

fn odometry(endpoint: Endpoint, qos: Qos) -> TopicIdentity<'static> {
    let (type_name, type_hash) = (Odometry::TYPE_NAME, Odometry::TYPE_HASH);
    TopicIdentity { endpoint, topic: "/cart7/odometry", type_name, type_hash, qos }
}

#[test]
fn keys_of_messages() {
    let key = data_key(7, "/cart7/odometry", Odometry::TYPE_NAME, Odometry::TYPE_HASH);
    assert_eq!(key, format!("7/cart7/odometry/nav_msgs::msg::dds_::Odometry_/{HASH}"));
}

#[test]
fn tokens_of_nodes_and_topics() {
    let session = "@ros2_lv/7/aac3178e146ba6f1fc6e6a4085e77f21/0";
    assert_eq!(node("/").token(), format!("{session}/0/NN/%/%/driftless"));
    assert_eq!(node("/cart7").token(), format!("{session}/0/NN/%/%cart7/driftless"));
    let publisher = node("/cart7").topic_token(3, &odometry(Endpoint::Publisher, Qos::reliable()));
    let topic = format!("%cart7%odometry/nav_msgs::msg::dds_::Odometry_/{HASH}");
    assert_eq!(publisher, format!("{session}/3/MP/%/%cart7/driftless/{topic}/1:2:1,10:,:,:,,"));
    let subscriber = node("/cart7").topic_token(4, &odometry(Endpoint::Subscriber, Qos::sensor_data()));
    assert_eq!(subscriber, format!("{session}/4/MS/%/%cart7/driftless/{topic}/2:2:1,5:,:,:,,"));
}

/// The value is by the reference implementation of XXH3 (Python's `xxhash.xxh3_128_intdigest(token).to_bytes(16, "little")`).
#[test]
fn the_id_of_a_publisher_is_the_hash_of_its_token() {
    let id = gid("@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener");
    assert_eq!(u128::from_be_bytes(id), 0x5bd7_2f4d_af53_c0bb_00c7_394e_7fc1_9547);
}

#[test]
fn attachments_are_33_bytes() {
    let attachment =
        Attachment { sequence_number: 1, source_stamp_ns: -2, gid: std::array::from_fn(|at| at as u8) };
    let bytes = attachment.to_bytes();
    let mut expected = vec![1, 0, 0, 0, 0, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 16];
    expected.extend(0..16);
    assert_eq!(bytes.as_slice(), expected);
    assert_eq!(Attachment::from_bytes(&bytes), Some(attachment));
}

#[test]
fn other_attachments_are_none() {
    let bytes = Attachment { sequence_number: 1, source_stamp_ns: 2, gid: [3; 16] }.to_bytes();
    for length in 0..bytes.len() {
        assert_eq!(Attachment::from_bytes(&bytes[..length]), None);
    }
    assert_eq!(Attachment::from_bytes(&[&bytes[..], &[0]].concat()), None);
    let mut other = bytes;
    other[16] = 15;
    assert_eq!(Attachment::from_bytes(&other), None);
}
