//! Routers between robots and servers, late ones, and ones that come back, with what the programs' own switches say.

use client::session::{SessionOptions, close_session, open_session};
use std::time::{Duration, Instant};
use tests::fleet::{FleetOperator, FleetRobot, FleetServer, PATIENCE, assert_works, router, session};
use tools::in_process::free_endpoint;

fn endpoint() -> String {
    free_endpoint().unwrap()
}

/// A fleet whose server, robot and operator have these options.
async fn fleet(
    server: &SessionOptions,
    robot: &SessionOptions,
    operator: &SessionOptions,
) -> (FleetServer, FleetRobot, FleetOperator) {
    let server = FleetServer::start(server).await;
    (server, FleetRobot::start("ada", robot).await, FleetOperator::start(operator).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_connect_to_the_server_itself() {
    let at = endpoint();
    let (mut server, mut robot, operator) =
        fleet(&session(&[&at], &[]), &session(&[], &[&at]), &session(&[], &[&at])).await;
    assert_works(&mut server, &mut robot, &operator).await;

    server.stop().await;
    let mut server = FleetServer::start(&session(&[&at], &[])).await;
    assert_works(&mut server, &mut robot, &operator).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn server_and_robots_connect_to_a_router() {
    let at = endpoint();
    let between = open_session(&router(&at, &[])).await.unwrap();
    let all = session(&[], &[&at]);
    let (mut server, mut robot, operator) = fleet(&all, &all, &all).await;
    assert_works(&mut server, &mut robot, &operator).await;

    close_session(&between).await;
    let between = open_session(&router(&at, &[])).await.unwrap();
    assert_works(&mut server, &mut robot, &operator).await;

    server.stop().await;
    let mut server = FleetServer::start(&all).await;
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&between).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_routers_are_a_chain() {
    let (near, far) = (endpoint(), endpoint());
    let first = open_session(&router(&near, &[])).await.unwrap();
    let second = open_session(&router(&far, &[&near])).await.unwrap();
    let (mut server, mut robot, operator) =
        fleet(&session(&[], &[&near]), &session(&[], &[&far]), &session(&[], &[&near])).await;
    assert_works(&mut server, &mut robot, &operator).await;

    close_session(&first).await;
    let first = open_session(&router(&near, &[])).await.unwrap();
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&second).await;
    let second = open_session(&router(&far, &[&near])).await.unwrap();
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&first).await;
    close_session(&second).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_may_come_late() {
    let at = endpoint();
    let all = session(&[], &[&at]);
    let late = async {
        tokio::time::sleep(Duration::from_millis(700)).await;
        open_session(&router(&at, &[])).await.unwrap()
    };
    let (between, (mut server, mut robot, operator)) = tokio::join!(late, fleet(&all, &all, &all));
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&between).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_listens_and_is_connected_to_a_router() {
    let (at, own) = (endpoint(), endpoint());
    let between = open_session(&router(&at, &[])).await.unwrap();
    // The robot is connected to the server, the operator to the router.
    let (mut server, mut robot, operator) =
        fleet(&session(&[&own], &[&at]), &session(&[], &[&own]), &session(&[], &[&at])).await;
    assert_works(&mut server, &mut robot, &operator).await;
    let mut other = FleetRobot::start("bo", &session(&[], &[&at])).await;
    assert_works(&mut server, &mut other, &operator).await;
    close_session(&between).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_knows_two_routers_and_one_ends() {
    let (one, two) = (endpoint(), endpoint());
    let first = open_session(&router(&one, &[])).await.unwrap();
    let second = open_session(&router(&two, &[&one])).await.unwrap();
    let both = session(&[], &[&one, &two]);
    let (mut server, mut robot, operator) = fleet(&both, &both, &both).await;
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&first).await;
    assert_works(&mut server, &mut robot, &operator).await;
    close_session(&second).await;
}

/// Prints how long the first answer takes after the return; run with `--ignored --nocapture`.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "a measurement of a minute, not a test"]
async fn time_to_the_first_answer_after_the_return() {
    let (near, far) = (endpoint(), endpoint());
    let mut first = open_session(&router(&near, &[])).await.unwrap();
    let second = open_session(&router(&far, &[&near])).await.unwrap();
    let server = session(&[], &[&near]);
    let operator = FleetOperator::start(&session(&[], &[&far])).await;
    let mut serving = FleetServer::start(&server).await;
    let mut robot = FleetRobot::start("ada", &session(&[], &[&far])).await;
    assert_works(&mut serving, &mut robot, &operator).await;
    let (mut after_router, mut after_server) = (Vec::new(), Vec::new());
    for down_ms in [50, 200, 500, 1000, 1500, 2000, 3000, 4000, 5000, 6000] {
        let down = Duration::from_millis(down_ms);
        close_session(&first).await;
        tokio::time::sleep(down).await;
        first = open_session(&router(&near, &[])).await.unwrap();
        after_router.push(ready(&robot).await);

        serving.stop().await;
        tokio::time::sleep(down).await;
        serving = FleetServer::start(&server).await;
        after_server.push(ready(&robot).await);
    }
    for (what, mut times) in [("router", after_router), ("server", after_server)] {
        times.sort();
        println!(
            "{what}: median {:?}, worst {:?} of {}",
            times[times.len() / 2],
            times[times.len() - 1],
            times.len()
        );
    }
    close_session(&second).await;
}

/// The time until a robot that asks every 50 ms is answered.
async fn ready(robot: &FleetRobot) -> Duration {
    let begin = Instant::now();
    while robot.map.info(Instant::now() + Duration::from_millis(50)).await.is_err() {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    begin.elapsed()
}
