//! When a query is repeated, and what is never reported as "no match". The server is a queryable in the same session.

use client::{ClientError, MapClient, QueryTasks, SessionOptions, close_session, open_session};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use protocol::{
    DescriptorFormat, DescriptorKind, ErrorCode, ErrorReply, FeatureSet, Format, KeyframeRecord, MapIdentity,
    MatchOutcome, MatchReply, MatchRequest, MatchStatus, MatchedKeyframe,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::Wait as _;
use zenoh::query::{Query, Queryable};

const KEY: &str = "map/hall/match";

fn camera() -> Camera {
    Camera {
        width: 640,
        height: 480,
        focal: [500.0; 2],
        centre: [319.5, 239.5],
        distortion: Distortion::None,
    }
}

fn request() -> MatchRequest {
    let format = DescriptorFormat { kind: DescriptorKind::Binary, width: 32 };
    MatchRequest {
        robot: "ada".to_owned(),
        stamp_ns: 17,
        camera: camera(),
        features: FeatureSet::empty(format),
        prior: None,
        gravity_in_camera: None,
        held: Vec::new(),
        map_version_held: None,
        max_keyframes: 4,
    }
}

fn keyframe() -> MatchReply {
    let keyframe = KeyframeRecord {
        id: 1,
        stamp_ns: 0,
        global_from_keyframe: PoseWithCovariance::exact(Pose::identity()),
        camera: camera(),
    };
    MatchReply::Keyframe(MatchedKeyframe {
        map_version: 3,
        map_identity: MapIdentity::from_bytes([7; 16]),
        rank: 0,
        keyframe,
        common_error: Vec::new(),
        cross_covariances: Vec::new(),
        matches: Vec::new(),
    })
}

fn status(outcome: MatchOutcome, keyframes_sent: u16) -> MatchReply {
    MatchReply::Done(MatchStatus {
        map_version: 3,
        map_identity: MapIdentity::from_bytes([7; 16]),
        outcome,
        keyframes_sent,
        searched_keyframes: 1,
        elapsed_us: 1,
        gravity_in_global: None,
        sigma_map_px: 1.0,
        log_odds: 4.0,
        log_prior_odds: 0.0,
    })
}

/// What the server does with one query.
#[derive(Clone)]
enum Behaviour {
    Silent,
    /// Never ends the query.
    Hold,
    Refuse(ErrorCode),
    Reply(Vec<MatchReply>),
    Raw(&'static [u8]),
}

/// A server in the session of its client. It goes through its behaviours and repeats the last one.
struct Scene {
    session: zenoh::Session,
    queries: Arc<AtomicUsize>,
    _server: Queryable<()>,
}

impl Scene {
    async fn new(behaviours: Vec<Behaviour>) -> Scene {
        let session = open_session(&SessionOptions::default()).await.unwrap();
        let queries = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&queries);
        let held = Mutex::new(Vec::new());
        let answer = move |query: Query| {
            let index = count.fetch_add(1, Ordering::Relaxed);
            let behaviour = behaviours.get(index).unwrap_or_else(|| behaviours.last().unwrap());
            behave(&query, behaviour);
            if matches!(behaviour, Behaviour::Hold) {
                held.lock().unwrap().push(query);
            }
        };
        let server = session.declare_queryable(KEY).callback(answer).await.unwrap();
        Scene { session, queries, _server: server }
    }

    fn client(&self) -> MapClient {
        MapClient::new(self.session.clone(), "hall").unwrap()
    }

    fn queries(&self) -> usize {
        self.queries.load(Ordering::Relaxed)
    }
}

fn behave(query: &Query, behaviour: &Behaviour) {
    let encoding = Format::Bincode.encoding();
    match behaviour {
        Behaviour::Silent | Behaviour::Hold => {}
        Behaviour::Refuse(code) => {
            let reply = ErrorReply::new(*code, "refused for the test");
            let payload = protocol::encode(Format::Bincode, &reply).unwrap();
            query.reply_err(payload).encoding(encoding).wait().unwrap();
        }
        Behaviour::Reply(replies) => {
            for reply in replies {
                let payload = protocol::encode(Format::Bincode, reply).unwrap();
                query.reply(KEY, payload).encoding(encoding).wait().unwrap();
            }
        }
        Behaviour::Raw(payload) => query.reply(KEY, *payload).encoding(encoding).wait().unwrap(),
    }
}

fn soon(milliseconds: u64) -> Instant {
    Instant::now() + Duration::from_millis(milliseconds)
}

#[tokio::test(flavor = "multi_thread")]
async fn silence_busy_and_incomplete_answers_are_repeated_until_the_answer_is_complete() {
    let matched = status(MatchOutcome::Matched, 1);
    let scene = Scene::new(vec![
        Behaviour::Silent,
        Behaviour::Refuse(ErrorCode::Busy),
        Behaviour::Reply(vec![keyframe()]),
        Behaviour::Reply(vec![matched.clone()]),
        Behaviour::Reply(vec![keyframe(), matched]),
    ])
    .await;
    let answer = scene.client().match_image(&request(), soon(20_000)).await.unwrap();
    assert_eq!((answer.status.outcome, answer.keyframes.len()), (MatchOutcome::Matched, 1));
    assert_eq!(scene.queries(), 5);
    close_session(&scene.session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_query_that_got_lost_is_repeated() {
    let found = Behaviour::Reply(vec![status(MatchOutcome::NoMatch, 0)]);
    let scene = Scene::new(vec![Behaviour::Hold, found]).await;
    let answer = scene.client().match_image(&request(), soon(20_000)).await.unwrap();
    assert_eq!((answer.status.outcome, scene.queries()), (MatchOutcome::NoMatch, 2));
    close_session(&scene.session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_the_deadline_a_failure_is_an_error_and_never_no_match() {
    type Law = fn(&ClientError) -> bool;
    let cases: [(Behaviour, Law); 4] = [
        (Behaviour::Silent, |error| matches!(error, ClientError::NoServer | ClientError::Deadline)),
        (Behaviour::Refuse(ErrorCode::Busy), |error| matches!(error, ClientError::Refused(_))),
        (Behaviour::Reply(vec![keyframe()]), |error| matches!(error, ClientError::Interrupted)),
        (Behaviour::Reply(vec![status(MatchOutcome::Matched, 2)]), |error| {
            matches!(error, ClientError::KeyframesMissing { received: 0, sent: 2 })
        }),
    ];
    for (behaviour, is_expected) in cases {
        let scene = Scene::new(vec![behaviour]).await;
        let begin = Instant::now();
        let error = scene.client().match_image(&request(), soon(400)).await.unwrap_err();
        assert!(is_expected(&error) && error.is_transient(), "{error:?}");
        assert!(begin.elapsed() < Duration::from_secs(5), "the deadline is kept");
        assert!(scene.queries() > 1, "{} queries", scene.queries());
        close_session(&scene.session).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn no_match_is_an_answer_and_needs_one_query() {
    let scene = Scene::new(vec![Behaviour::Reply(vec![status(MatchOutcome::NoMatch, 0)])]).await;
    let answer = scene.client().match_image(&request(), soon(5_000)).await.unwrap();
    assert_eq!(
        (answer.status.outcome, answer.keyframes.len(), scene.queries()),
        (MatchOutcome::NoMatch, 0, 1)
    );
    close_session(&scene.session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn refusals_and_unreadable_answers_are_not_repeated() {
    for behaviour in [Behaviour::Refuse(ErrorCode::UnknownMap), Behaviour::Raw(b"hello")] {
        let scene = Scene::new(vec![behaviour]).await;
        let error = scene.client().match_image(&request(), soon(5_000)).await.unwrap_err();
        assert!(!error.is_transient() && scene.queries() == 1, "{error:?}");
        close_session(&scene.session).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_does_not_end_is_given_up() {
    let scene = Scene::new(vec![Behaviour::Reply(vec![keyframe(); 200])]).await;
    let error = scene.client().match_image(&request(), soon(5_000)).await.unwrap_err();
    assert!(matches!(error, ClientError::TooLong { replies: 66, .. }) && scene.queries() == 1, "{error:?}");
    close_session(&scene.session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_awaits_the_map_repeats_unknown_map() {
    let found = Behaviour::Reply(vec![status(MatchOutcome::NoMatch, 0)]);
    let scene = Scene::new(vec![Behaviour::Refuse(ErrorCode::UnknownMap), found]).await;
    let answer = scene.client().awaiting_map().match_image(&request(), soon(5_000)).await.unwrap();
    assert_eq!((answer.status.outcome, scene.queries()), (MatchOutcome::NoMatch, 2));
    close_session(&scene.session).await;
}

#[test]
fn a_task_without_a_server_is_repeated_and_the_next_one_is_not() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let session = runtime.block_on(open_session(&SessionOptions::default())).unwrap();
    let client = MapClient::new(session.clone(), "hall").unwrap();
    let mut queries = QueryTasks::new(client, runtime.handle().clone(), Duration::from_millis(300));
    let bytes = |queries: &mut QueryTasks<&'static str>, token: &'static str| {
        queries.submit(token, request());
        let result = queries.wait().unwrap();
        assert_eq!((result.token, result.request.stamp_ns, queries.pending()), (token, 17, 0));
        assert!(matches!(result.answer, Err(ClientError::NoServer)));
        result.bytes_sent
    };
    let (first, second) = (bytes(&mut queries, "first"), bytes(&mut queries, "second"));
    assert!(first >= 2 * second && second > 0, "{first} bytes, then {second}");
    assert!(queries.poll().is_none() && queries.wait().is_none());
    runtime.block_on(close_session(&session));
}

/// Their tasks never run, as where a runtime hangs: a robot must be able to ask again.
#[test]
fn queries_whose_tasks_never_report_end_after_their_deadline() {
    let network = tokio::runtime::Runtime::new().unwrap();
    let session = network.block_on(open_session(&SessionOptions::default())).unwrap();
    // Of a runtime of one thread nothing runs while nobody drives it.
    let idle = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let hall = MapClient::new(session.clone(), "hall").unwrap();
    let mut queries = QueryTasks::new(hall, idle.handle().clone(), Duration::from_millis(100));
    for token in 0..4 {
        queries.submit(token, request());
    }
    assert!(queries.poll().is_none(), "not yet");
    for token in 0..4 {
        let result = queries.wait().unwrap();
        assert_eq!(result.token, token);
        assert!(matches!(result.answer, Err(ClientError::Deadline)), "{:?}", result.answer);
        assert!(result.elapsed < Duration::from_secs(2), "{:?}", result.elapsed);
    }
    assert_eq!(queries.pending(), 0);
    assert!(queries.wait().is_none());
    // What comes too late belongs to nobody.
    idle.block_on(async {
        tokio::time::timeout(Duration::from_millis(1), std::future::pending::<()>()).await.ok()
    });
    assert!(queries.poll().is_none());
    network.block_on(close_session(&session));
}
