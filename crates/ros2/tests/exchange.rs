//! Two nodes over real Zenoh sessions.

use ros_messages::geometry_msgs::TransformStamped;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{Image, Imu};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{CdrError, RosMessage, decode, encode};
use ros2::liveliness::Endpoint;
use ros2::{Attachment, History, Node, NodeOptions, Qos, Subscriber, explain_silence};
use std::net::TcpListener;
use std::time::Duration;
use zenoh::Session;
use zenoh::query::ConsolidationMode;

const TIMEOUT: Duration = Duration::from_secs(20);

async fn session(listen: &str, connect: &str) -> Session {
    let mut config = zenoh::Config::default();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    config.insert_json5("listen/endpoints", listen).unwrap();
    config.insert_json5("connect/endpoints", connect).unwrap();
    zenoh::open(config).await.unwrap()
}

/// Two connected sessions.
async fn sessions() -> (Session, Session) {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("[\"tcp/127.0.0.1:{port}\"]");
    (session(&endpoint, "[]").await, session("[]", &endpoint).await)
}

async fn node(session: &Session, name: &str) -> Node {
    let options = NodeOptions { domain: 3, namespace: "/cart7".to_owned(), name: name.to_owned() };
    Node::new(session.clone(), options).await.unwrap()
}

async fn next<M: RosMessage + Send + 'static>(subscriber: &Subscriber<M>) -> ros2::Received<M> {
    tokio::time::timeout(TIMEOUT, subscriber.receive()).await.expect("in time").unwrap()
}

/// Waits until a token of a pattern is on the network as `session` sees it, or is not.
async fn wait_for_token(session: &Session, pattern: &str, there: bool) {
    let look = async {
        loop {
            let replies = session.liveliness().get(pattern).await.unwrap();
            if replies.recv_async().await.is_ok() == there {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(TIMEOUT, look).await.unwrap_or_else(|_| panic!("{pattern}: expected {there}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_arrive_in_order_with_number_and_sender() {
    let (first, second) = sessions().await;
    let (sender, receiver) = (node(&first, "sender").await, node(&second, "receiver").await);
    let subscriber = receiver.subscriber::<Odometry>("odometry", Qos::reliable(), 10).await.unwrap();
    let publisher = sender.publisher::<Odometry>("/cart7/odometry", Qos::reliable()).await.unwrap();
    wait_for_token(&first, "@ros2_lv/3/*/*/*/MS/%/%cart7/receiver/%cart7%odometry/**", true).await;
    let odometry = Odometry { child_frame_id: "base_link".to_owned(), ..Odometry::default() };
    // A declaration reaches the other session some time after the token.
    let mut first_number = None;
    while first_number.is_none() {
        publisher.publish(&odometry).await.unwrap();
        tokio::time::sleep(Duration::from_millis(50)).await;
        first_number =
            subscriber.try_receive().unwrap().map(|received| received.attachment.unwrap().sequence_number);
    }
    publisher.publish(&odometry).await.unwrap();
    let received = next(&subscriber).await;
    assert_eq!(received.message.unwrap(), odometry);
    assert_eq!(received.attachment.unwrap().sequence_number, first_number.unwrap() + 1);
    wait_for_token(&second, "@ros2_lv/3/*/0/0/NN/%/%cart7/sender", true).await;
    drop((publisher, sender));
    wait_for_token(&second, "@ros2_lv/3/*/*/*/*/%/%cart7/sender/**", false).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_messages_wait_for_a_slow_receiver() {
    let (session, _) = sessions().await;
    let node = node(&session, "both").await;
    let subscriber = node.subscriber::<Image>("/cam0/image_raw", Qos::sensor_data(), 2).await.unwrap();
    let publisher = node.publisher::<Image>("/cam0/image_raw", Qos::sensor_data()).await.unwrap();
    for width in 1..=5 {
        publisher.publish(&Image { width, ..Image::default() }).await.unwrap();
    }
    let widths =
        [next(&subscriber).await, next(&subscriber).await].map(|received| received.message.unwrap().width);
    assert_eq!(widths, [4, 5]);
    assert!(subscriber.try_receive().unwrap().is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_message_is_an_error_and_the_next_one_arrives() {
    let (session, _) = sessions().await;
    let node = node(&session, "receiver").await;
    let subscriber = node.subscriber::<Imu>("/imu", Qos::sensor_data(), 10).await.unwrap();
    let good = encode(&Imu::default()).unwrap();
    // Any version of the type, and no attachment.
    for payload in [b"?".to_vec(), good[..50].to_vec(), good.clone()] {
        session.put("3/imu/sensor_msgs::msg::dds_::Imu_/TypeHashNotSupported", payload).await.unwrap();
    }
    assert!(matches!(next(&subscriber).await.message, Err(CdrError::NoHeader { .. })));
    assert!(matches!(next(&subscriber).await.message, Err(CdrError::Malformed { .. })));
    let received = next(&subscriber).await;
    assert_eq!(received.message.unwrap(), Imu::default());
    assert_eq!(received.attachment, None);
}

/// Sends the history of the publishers of a key, as zenoh-ext's advanced subscriber asks for it.
async fn history(session: &Session, selector: &str) -> Vec<zenoh::sample::Sample> {
    let replies = session.get(selector).consolidation(ConsolidationMode::None).await.unwrap();
    let mut samples = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        samples.push(reply.into_result().unwrap());
    }
    samples
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_later_gets_what_a_latched_topic_had_before() {
    let (first, second) = sessions().await;
    let (sender, receiver) = (node(&first, "sender").await, node(&second, "receiver").await);
    let early = receiver.subscriber::<TFMessage>("/tf_static", Qos::latched(), 10).await.unwrap();
    let publisher = sender.publisher::<TFMessage>("/tf_static", Qos::latched()).await.unwrap();
    let message = |child: &str| TFMessage {
        transforms: vec![TransformStamped {
            child_frame_id: child.to_owned(),
            ..TransformStamped::default()
        }],
    };
    for child in ["imu", "imu_link"] {
        publisher.publish(&message(child)).await.unwrap();
    }
    // The first message may have come too; each comes once.
    let mut received = next(&early).await;
    if received.attachment.unwrap().sequence_number == 1 {
        received = next(&early).await;
    }
    assert_eq!(received.message.unwrap(), message("imu_link"));
    let late = receiver.subscriber::<TFMessage>("/tf_static", Qos::latched(), 10).await.unwrap();
    let received = next(&late).await;
    assert_eq!(received.attachment.unwrap().sequence_number, 2);
    assert_eq!(received.message.unwrap(), message("imu_link"));
    // A volatile subscriber gets nothing.
    let volatile = receiver.subscriber::<TFMessage>("/tf_static", Qos::reliable(), 10).await.unwrap();
    publisher.publish(&message("imu")).await.unwrap();
    for subscriber in [&late, &early, &volatile] {
        let received = next(subscriber).await;
        assert_eq!(received.attachment.unwrap().sequence_number, 3);
        assert!(subscriber.try_receive().unwrap().is_none());
    }
    // What another implementation asks for, and sees.
    let key = format!("3/tf_static/tf2_msgs::msg::dds_::TFMessage_/{}", TFMessage::TYPE_HASH);
    let name = format!("{key}/@adv/pub/{}/1/_", first.zid());
    wait_for_token(&second, &name, true).await;
    for selector in [format!("{key}/@adv/**?_anyke;_max=1"), format!("{name}?_anyke")] {
        let samples = history(&second, &selector).await;
        assert_eq!(samples.len(), 1, "{selector}");
        assert_eq!(samples[0].key_expr().as_str(), key);
        assert_eq!(decode::<TFMessage>(&samples[0].payload().to_bytes()).unwrap(), message("imu"));
        let attachment = Attachment::from_bytes(&samples[0].attachment().unwrap().to_bytes()).unwrap();
        assert_eq!(attachment.sequence_number, 3);
    }
    drop(publisher);
    wait_for_token(&second, &name, false).await;
    assert!(history(&second, &format!("{key}/@adv/**?_anyke")).await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_history_holds_as_many_messages_as_its_depth() {
    let (session, _) = sessions().await;
    let node = node(&session, "both").await;
    let qos = Qos { history: History::KeepLast(3), ..Qos::latched() };
    let publisher = node.publisher::<Image>("/map_image", qos).await.unwrap();
    for width in 1..=5 {
        publisher.publish(&Image { width, ..Image::default() }).await.unwrap();
    }
    let late = node.subscriber::<Image>("/map_image", qos, 10).await.unwrap();
    for width in 3..=5 {
        assert_eq!(next(&late).await.message.unwrap().width, width);
    }
    let key = format!("3/map_image/sensor_msgs::msg::dds_::Image_/{}", Image::TYPE_HASH);
    assert_eq!(history(&session, &format!("{key}/@adv/**?_anyke;_max=2")).await.len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_topic_of_another_domain_is_found_and_named() {
    let (first, second) = sessions().await;
    let (sender, options) = (node(&first, "sender").await, NodeOptions::default());
    let _publisher = sender.publisher::<Imu>("/imu", Qos::sensor_data()).await.unwrap();
    wait_for_token(&second, "@ros2_lv/3/*/*/*/MP/**", true).await;
    let receiver = Node::new(second, options).await.unwrap();
    let wanted = receiver.counterpart::<Imu>(Endpoint::Publisher, "/imu").unwrap();
    let found = receiver.discover().await.unwrap();
    assert_eq!(explain_silence(&found, &wanted), "/imu exists in domain 3, not in 0");
}
