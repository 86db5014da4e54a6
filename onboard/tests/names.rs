//! Robots of one name find each other.

use client::{SessionOptions, close_session, open_session};
use onboard::outputs::Publisher;
use std::net::TcpListener;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

/// Sessions of which the first listens and the others connect to it.
fn connected<const COUNT: usize>() -> (Runtime, [zenoh::Session; COUNT]) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let listening = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    let connecting = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let options = |at: usize| if at == 0 { &listening } else { &connecting };
    let sessions = std::array::from_fn(|at| runtime.block_on(open_session(options(at))).unwrap());
    (runtime, sessions)
}

#[test]
fn two_robots_of_one_name_are_noticed_by_both_and_others_are_not() {
    let (runtime, [first, second, third]) = connected();

    let publisher = |session: &zenoh::Session, name| {
        Publisher::new(session.clone(), runtime.handle(), name, Some("hall"), protocol::Format::Json).unwrap()
    };
    let robots = [publisher(&first, "robot7"), publisher(&second, "robot7"), publisher(&third, "robot8")];
    let deadline = Instant::now() + Duration::from_secs(20);
    while robots[0].namesakes() == 0 || robots[1].namesakes() == 0 {
        assert!(Instant::now() < deadline, "the robots did not notice each other");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(robots.each_ref().map(Publisher::namesakes), [1, 1, 0]);
    for robot in robots {
        robot.close(None);
    }
    for session in [first, second, third] {
        runtime.block_on(close_session(&session));
    }
}

#[test]
fn of_tokens_that_somebody_makes_up_only_some_are_kept_and_told() {
    let (runtime, [robot, other]) = connected();
    let declare =
        |key: String| runtime.block_on(async { other.liveliness().declare_token(key).await }).unwrap();
    let made_up: Vec<_> = (0..300).map(|k| declare(format!("robot/robot7/session/{k}"))).collect();
    let json = protocol::Format::Json;
    let publisher = Publisher::new(robot.clone(), runtime.handle(), "robot7", Some("hall"), json).unwrap();
    let begin = Instant::now();
    while publisher.namesakes() < 16 {
        assert!(begin.elapsed() < Duration::from_secs(20), "the robot noticed nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
    let last = declare("robot/robot7/session/last".to_owned());
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(publisher.namesakes(), 16);
    publisher.close(None);
    drop((made_up, last));
    for session in [robot, other] {
        runtime.block_on(close_session(&session));
    }
}
