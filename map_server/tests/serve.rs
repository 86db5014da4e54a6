//! Laws of the served maps, over real Zenoh sessions on the loopback.

use std::sync::Arc;
use std::time::Duration;

use client::{SessionOptions, open_session};
use map::Keyframe;
use map_server::{MapServer, ServeError, ServedMap, ServerOptions};
use protocol::{
    DescriptorKind, Descriptors, ErrorCode, ErrorReply, FeatureSet, Format, KeyframeReply, LocalizeReply,
    LocalizeRequest, MapChangeNotice, MapInfoReply, MatchOutcome, MatchReply, MatchRequest, Message,
    StatedChange,
};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{KeyframeVerdict, LoadedMap};
use testing::{Place, PlaceOptions};
use zenoh::Session;
use zenoh::query::ConsolidationMode;

mod feature_kinds;
mod notices;

/// A server with the map `hall` and a client, connected over the loopback.
struct Scene {
    place: Place,
    server: MapServer,
    client: Session,
    serving: Session,
    endpoint: String,
}

async fn peer(listen: &[&str], connect: &[&str]) -> Session {
    let owned = |endpoints: &[&str]| endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect();
    let options =
        SessionOptions { listen: owned(listen), connect: owned(connect), ..SessionOptions::default() };
    open_session(&options).await.unwrap()
}

/// A session on a port that nothing else uses, and its endpoint.
async fn listening() -> (Session, String) {
    loop {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
        if let Ok(session) = open_session(&options).await {
            return (session, endpoint);
        }
    }
}

fn served(name: &str, place: &Place) -> ServedMap {
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    ServedMap { name: name.to_owned(), map: Arc::new(map) }
}

fn small_place() -> Place {
    Place::new(&PlaceOptions { keyframes: 40, landmarks: 2000, ..PlaceOptions::default() })
}

impl Scene {
    async fn new() -> Scene {
        Scene::with(ServerOptions::default()).await
    }

    async fn with(options: ServerOptions) -> Scene {
        let place = small_place();
        let (serving, endpoint) = listening().await;
        let server = MapServer::start(serving.clone(), vec![served("hall", &place)], options).await.unwrap();
        let client = peer(&[], &[&endpoint]).await;
        let scene = Scene { place, server, client, serving, endpoint };
        scene.wait_for_info().await;
        scene
    }

    /// A query right after connecting may find nothing: empty is retry.
    async fn wait_for_info(&self) {
        while ask(&self.client, "map/hall/info", None, None).await.is_empty() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    fn request(&self, seed: u64, max_keyframes: u16) -> MatchRequest {
        self.place.request(
            &self.place.camera_at(8.3, 0.4, 0.1),
            max_keyframes,
            &mut StdRng::seed_from_u64(seed),
        )
    }

    async fn end(self) {
        self.server.stop().await.unwrap();
        self.client.close().await.unwrap();
        self.serving.close().await.unwrap();
    }
}

/// A reply: key, encoding and payload, or the error's encoding and payload.
type Answer = Result<(String, String, Vec<u8>), (String, Vec<u8>)>;

async fn ask(
    session: &Session,
    selector: &str,
    payload: Option<Vec<u8>>,
    encoding: Option<&str>,
) -> Vec<Answer> {
    let mut query =
        session.get(selector).consolidation(ConsolidationMode::None).timeout(Duration::from_mins(1));
    if let Some(payload) = payload {
        query = query.payload(payload);
    }
    if let Some(encoding) = encoding {
        query = query.encoding(encoding);
    }
    let replies = query.await.unwrap();
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        answers.push(match reply.into_result() {
            Ok(sample) => {
                let (key, encoding) = (sample.key_expr().to_string(), sample.encoding().to_string());
                Ok((key, encoding, sample.payload().to_bytes().into_owned()))
            }
            Err(error) => Err((error.encoding().to_string(), error.payload().to_bytes().into_owned())),
        });
    }
    answers
}

async fn ask_bincode<Q: Message, A: Message>(session: &Session, selector: &str, question: &Q) -> Vec<A> {
    let payload = protocol::encode(Format::Bincode, question).unwrap();
    let answers = ask(session, selector, Some(payload), Some(Format::Bincode.encoding())).await;
    answers.into_iter().map(|answer| decoded(answer, Format::Bincode)).collect()
}

fn decoded<A: Message>(answer: Answer, format: Format) -> A {
    let (_, encoding, payload) = answer.unwrap();
    assert_eq!(encoding, format.encoding());
    protocol::decode(format, &payload).unwrap()
}

fn only_error(answers: &[Answer], format: Format) -> ErrorReply {
    assert_eq!(answers.len(), 1, "{answers:?}");
    let (encoding, payload) = answers[0].as_ref().unwrap_err();
    assert_eq!(encoding, format.encoding());
    protocol::decode(format, payload).unwrap()
}

fn localize_request(request: MatchRequest) -> LocalizeRequest {
    let MatchRequest { camera, features, prior, gravity_in_camera, .. } = request;
    LocalizeRequest { camera, features, prior, gravity_in_camera }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_match_has_one_keyframe_a_reply_and_ends_with_the_status() {
    let scene = Scene::new().await;
    let replies: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", &scene.request(1, 3)).await;
    let (last, keyframes) = replies.split_last().unwrap();
    let MatchReply::Done(status) = last else { panic!("the last reply is not the status") };
    assert_eq!(status.outcome, MatchOutcome::Matched);
    assert_eq!(usize::from(status.keyframes_sent), keyframes.len());
    assert_eq!(keyframes.len(), 3);
    assert!(keyframes.iter().all(|reply| matches!(reply, MatchReply::Keyframe(_))));
    assert_eq!(scene.server.statistics().failed, 0);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_shows_queries_is_told_what_matched_for_whom_and_why_not() {
    let scene = Scene::new().await;
    let mut reports = scene.server.reports();
    let request = scene.request(1, 3);
    let replies: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match?client=r7", &request).await;
    let sent = replies.iter().filter_map(|reply| match reply {
        MatchReply::Keyframe(matched) => Some(matched.keyframe.id),
        MatchReply::Done(_) => None,
    });
    let report = reports.recv().await.unwrap();
    assert_eq!((report.kind, report.client.as_str(), report.map.as_str()), ("match", "r7", "hall"));
    let answered = report.result.unwrap();
    assert_eq!(answered.keyframes, sent.collect::<Vec<_>>());
    assert_eq!((answered.outcome, answered.features), (MatchOutcome::Matched, request.features.len()));
    let best = &answered.search.candidates[0];
    assert!(
        best.in_answer && best.inliers > 8 && best.votes >= 4 && best.inliers <= best.matches,
        "{best:?}"
    );
    assert!(answered.search.camera_in_global().is_some());

    // Where each feature is where another was, no pose explains the matches.
    let mut shuffled = request.clone();
    shuffled.features.pixels.rotate_left(request.features.len() / 2);
    let _: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", &shuffled).await;
    let refused = reports.recv().await.unwrap();
    assert_eq!(refused.client, "");
    let refused = refused.result.unwrap();
    assert_eq!((refused.outcome, refused.keyframes.len()), (MatchOutcome::NotVerified, 0));
    assert!(refused.search.candidates.iter().all(|candidate| !candidate.in_answer));
    let reasons: Vec<_> =
        refused.search.candidates.iter().filter_map(|candidate| candidate.verdict).collect();
    assert!(reasons.contains(&KeyframeVerdict::NoPose), "{reasons:?}");

    let long = format!("map/hall/match?client={}", "x".repeat(500));
    ask(&scene.client, &long, Some(b"hello".to_vec()), None).await;
    let failed = reports.recv().await.unwrap();
    assert_eq!(failed.client.len(), 64);
    assert_eq!(failed.result.unwrap_err().code, ErrorCode::BadRequest);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_localized_in_bincode_and_in_json_alike() {
    let scene = Scene::new().await;
    let request = localize_request(scene.request(2, 1));
    let replies: Vec<LocalizeReply> = ask_bincode(&scene.client, "map/hall/localize", &request).await;
    let truth = scene.place.camera_at(8.3, 0.4, 0.1);
    let fix = replies[0].fix.as_ref().unwrap();
    assert!(truth.local(&fix.global_from_camera.pose).fixed_rows::<3>(3).norm() < 0.3);

    let json = protocol::encode(Format::Json, &request).unwrap();
    let selectors =
        [("map/hall/localize", Some("application/json")), ("map/hall/localize?format=json", None)];
    for (selector, encoding) in selectors {
        let answers = ask(&scene.client, selector, Some(json.clone()), encoding).await;
        assert_eq!(answers.len(), 1);
        let reply: LocalizeReply = decoded(answers[0].clone(), Format::Json);
        assert_eq!(reply, replies[0]);
    }
    // Bincode in, JSON out.
    let payload = protocol::encode(Format::Bincode, &request).unwrap();
    let selector = "map/hall/localize?format=json";
    let answers = ask(&scene.client, selector, Some(payload), Some(Format::Bincode.encoding())).await;
    assert_eq!(decoded::<LocalizeReply>(answers[0].clone(), Format::Json), replies[0]);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_can_be_read_remotely() {
    let scene = Scene::new().await;
    let answers = ask(&scene.client, "map/hall/info?format=json", None, None).await;
    let info: MapInfoReply = decoded(answers[0].clone(), Format::Json);
    assert_eq!(info.name, "hall");
    assert_eq!(info.keyframes as usize, scene.place.map.keyframes.len());
    assert_eq!(info.landmarks as usize, scene.place.map.landmarks.len());
    assert_eq!(info.observations as usize, scene.place.map.observation_count());
    assert_eq!(info.gravity_in_global, scene.place.map.info.gravity_in_global.map(Into::into));

    let keyframe = &scene.place.map.keyframes[4];
    let answers = ask(&scene.client, &format!("map/hall/keyframes/{}", keyframe.id), None, None).await;
    let reply: KeyframeReply = decoded(answers[0].clone(), Format::Bincode);
    assert_eq!(reply.keyframe.global_from_keyframe, keyframe.global_from_keyframe);
    let all = ask(&scene.client, "map/hall/keyframes/*", None, None).await;
    let keys: Vec<String> = all.into_iter().map(|answer| answer.unwrap().0).collect();
    let key = |keyframe: &Keyframe| format!("map/hall/keyframes/{}", keyframe.id);
    assert_eq!(keys, scene.place.map.keyframes.iter().map(key).collect::<Vec<_>>());

    let unknown = ask(&scene.client, "map/hall/keyframes/987654", None, None).await;
    assert_eq!(only_error(&unknown, Format::Bincode).code, ErrorCode::UnknownKeyframe);
    let nonsense = ask(&scene.client, "map/hall/keyframes/door", None, None).await;
    assert_eq!(only_error(&nonsense, Format::Bincode).code, ErrorCode::BadRequest);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_queries_are_answered_with_errors_and_the_server_goes_on() {
    let scene = Scene::new().await;
    let good = protocol::encode(Format::Bincode, &scene.request(3, 1)).unwrap();
    let changed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut payload = good.clone();
        change(&mut payload);
        payload
    };
    let hostile_length = changed(&|payload| payload[8..12].copy_from_slice(&u32::MAX.to_le_bytes()));
    let cases: Vec<(Option<Vec<u8>>, ErrorCode)> = vec![
        (None, ErrorCode::BadRequest),
        (Some(b"hello".to_vec()), ErrorCode::BadRequest),
        (Some(format!("{{\"schema\": {}}}", protocol::SCHEMA_VERSION).into_bytes()), ErrorCode::BadRequest),
        (Some(vec![0xff; 100_000]), ErrorCode::BadRequest),
        (Some(changed(&|payload| payload.truncate(payload.len() / 2))), ErrorCode::BadRequest),
        (Some(changed(&|payload| *payload.last_mut().unwrap() ^= 1)), ErrorCode::BadRequest),
        (Some(hostile_length), ErrorCode::BadRequest),
        (Some(changed(&|payload| payload[4] = 99)), ErrorCode::SchemaMismatch),
    ];
    for (payload, code) in cases {
        let answers = ask(&scene.client, "map/hall/match?format=json", payload.clone(), None).await;
        assert_eq!(only_error(&answers, Format::Json).code, code, "{payload:02x?}");
    }
    let answers = ask(&scene.client, "map/hall/info?format=xml", None, None).await;
    assert_eq!(only_error(&answers, Format::Bincode).code, ErrorCode::BadRequest);

    let mut foreign = scene.request(4, 1);
    let bytes = foreign.features.descriptors.bytes[..16 * foreign.features.len()].to_vec();
    foreign.features.descriptors = Descriptors { kind: DescriptorKind::Binary, width: 16, bytes };
    let payload = protocol::encode(Format::Bincode, &foreign).unwrap();
    let answers = ask(&scene.client, "map/hall/match", Some(payload), None).await;
    assert_eq!(only_error(&answers, Format::Bincode).code, ErrorCode::DescriptorMismatch);

    let still: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", &scene.request(5, 1)).await;
    assert_eq!(still.len(), 2);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_the_schemas_before_and_after_are_answered() {
    let scene = Scene::new().await;
    let payload = protocol::encode(Format::Json, &scene.request(5, 1)).unwrap();
    let own = format!("\"schema\":{},", protocol::SCHEMA_VERSION);
    let next = format!("\"schema\":{},\"floor\":3,", protocol::SCHEMA_VERSION + 1);
    let former = format!("\"schema\":{},", protocol::SCHEMA_VERSION - 1);
    for other in [next, former] {
        let payload = String::from_utf8(payload.clone()).unwrap().replacen(&own, &other, 1).into_bytes();
        let json = Some(Format::Json.encoding());
        let answers = ask(&scene.client, "map/hall/match?format=json", Some(payload), json).await;
        let replies: Vec<MatchReply> =
            answers.into_iter().map(|answer| decoded(answer, Format::Json)).collect();
        assert!(matches!(replies.as_slice(), [MatchReply::Keyframe(_), MatchReply::Done(_)]), "{replies:?}");
    }
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_features_is_an_outcome() {
    let scene = Scene::new().await;
    let mut request = scene.request(6, 1);
    let width = 32;
    let descriptors = Descriptors { kind: DescriptorKind::Binary, width, bytes: Vec::new() };
    request.features = FeatureSet { pixels: Vec::new(), descriptors, extractor: String::new() };
    let replies: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", &request).await;
    let [MatchReply::Done(status)] = replies.as_slice() else { panic!("{replies:?}") };
    assert_eq!(status.outcome, MatchOutcome::TooFewFeatures);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unknown_map_is_an_error_that_lists_the_known_ones() {
    let scene = Scene::new().await;
    for selector in ["map/cellar/info", "map/cellar/match", "map/cellar/localize", "map/cellar/keyframes/3"] {
        let error = only_error(&ask(&scene.client, selector, None, None).await, Format::Bincode);
        assert_eq!(error.code, ErrorCode::UnknownMap);
        assert!(error.message.contains("cellar") && error.message.contains("hall"), "{error}");
    }
    // Asking for all maps is not asking for an unknown one.
    let answers = ask(&scene.client, "map/*/info", None, None).await;
    let info: MapInfoReply = decoded(answers[0].clone(), Format::Bincode);
    assert_eq!((answers.len(), info.name.as_str()), (1, "hall"));
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_do_not_shadow_each_other() {
    let scene = Scene::new().await;
    let (second, endpoint) = listening().await;
    let yard = vec![served("yard", &scene.place), served("roof", &scene.place)];
    let server = MapServer::start(second.clone(), yard, ServerOptions::default()).await.unwrap();
    let both = peer(&[], &[&scene.endpoint, &endpoint]).await;
    for map in ["hall", "yard", "roof"] {
        let key = format!("map/{map}/info");
        // Until both servers are connected, the other one may say that it has no such map.
        let info = loop {
            let answers = ask(&both, &key, None, None).await;
            if let [Ok(_)] = answers.as_slice() {
                break decoded::<MapInfoReply>(answers[0].clone(), Format::Bincode);
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        };
        assert_eq!(info.name, map);
        for _ in 0..5 {
            let answers = ask(&both, &key, None, None).await;
            assert!(matches!(answers.as_slice(), [Ok(_)]), "{map} is shadowed: {answers:?}");
        }
    }
    both.close().await.unwrap();
    server.stop().await.unwrap();
    second.close().await.unwrap();
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_turned_away_and_everybody_is_answered() {
    let mut options = ServerOptions::default();
    options.workers = 1;
    options.queue_length = 2;
    let scene = Scene::with(options).await;
    let payload = protocol::encode(Format::Bincode, &scene.request(7, 1)).unwrap();
    let flood = (0..40).map(|_| {
        let (client, payload) = (scene.client.clone(), payload.clone());
        tokio::spawn(async move { ask(&client, "map/hall/match", Some(payload), None).await })
    });
    let mut refused = 0;
    for asked in flood.collect::<Vec<_>>() {
        let answers = asked.await.unwrap();
        assert!(!answers.is_empty());
        if answers[0].is_err() {
            assert_eq!(only_error(&answers, Format::Bincode).code, ErrorCode::Busy);
            refused += 1;
        } else {
            assert_eq!(answers.len(), 2);
        }
    }
    assert_eq!(scene.server.statistics().refused, refused);
    let after: Vec<MatchReply> = ask_bincode(&scene.client, "map/hall/match", &scene.request(8, 1)).await;
    assert_eq!(after.len(), 2);
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_liveliness_token_says_when_a_server_is_there() {
    let mut options = ServerOptions::default();
    options.name = Some("north".to_owned());
    let scene = Scene::with(options).await;
    let watch = scene.client.liveliness().declare_subscriber("map_server/*").history(true).await.unwrap();
    let there = watch.recv_async().await.unwrap();
    assert_eq!(there.key_expr().as_str(), "map_server/north");
    assert_eq!(there.kind(), zenoh::sample::SampleKind::Put);
    // The token was declared last: whoever sees it is answered.
    assert_eq!(ask(&scene.client, "map/hall/info", None, None).await.len(), 1);

    let Scene { server, client, serving, .. } = scene;
    server.stop().await.unwrap();
    let gone = watch.recv_async().await.unwrap();
    assert_eq!(gone.kind(), zenoh::sample::SampleKind::Delete);
    assert!(ask(&client, "map/hall/info", None, None).await.is_empty());
    client.close().await.unwrap();
    serving.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replaced_map_is_announced_and_answers_with_its_version() {
    let scene = Scene::new().await;
    let news = scene.client.declare_subscriber("map/hall/changes").await.unwrap();
    let mut contents = scene.place.map.clone();
    contents.info.version = 8;
    let moved = contents.keyframes[3].id;
    contents.keyframes[3].global_from_keyframe.pose.translation.x += 0.02;
    let map = Arc::new(LoadedMap::from_contents(contents).unwrap());
    let stated = StatedChange { sigma_theta_rad: 0.001, sigma_p_m: 0.02 };
    let change = loop {
        // The subscription may still be on its way to the server.
        scene.server.replace("hall", Arc::clone(&map), Some(stated)).await.unwrap();
        if let Ok(sample) = tokio::time::timeout(Duration::from_millis(200), news.recv_async()).await {
            break protocol::decode::<MapChangeNotice>(
                Format::Bincode,
                &sample.unwrap().payload().to_bytes(),
            )
            .unwrap();
        }
    };
    assert_eq!((change.version, change.stated_change), (8, Some(stated)));
    assert!(change.changed.is_empty() || change.changed == [moved]);
    let answers = ask(&scene.client, "map/hall/info", None, None).await;
    assert_eq!(decoded::<MapInfoReply>(answers[0].clone(), Format::Bincode).version, 8);
    assert!(scene.server.replace("cellar", map, None).await.is_err());

    // Another map is no version of this one.
    let other = Place::new(&PlaceOptions { seed: 3, keyframes: 4, landmarks: 60, ..PlaceOptions::default() });
    let other = Arc::new(LoadedMap::from_contents(other.map).unwrap());
    let error = scene.server.replace("hall", Arc::clone(&other), None).await.unwrap_err();
    assert!(matches!(error, ServeError::OtherMap { .. }), "{error}");
    let said = error.to_string();
    assert!(said.contains("hall") && said.contains(&other.identity().to_string()), "{said}");
    let answers = ask(&scene.client, "map/hall/info", None, None).await;
    let info = decoded::<MapInfoReply>(answers[0].clone(), Format::Bincode);
    assert_eq!((info.version, info.identity), (8, scene.place.map.info.identity.unwrap()));
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_impossible_names_does_not_start() {
    let place = small_place();
    let (session, _) = listening().await;
    for names in [vec!["a/b"], vec![""], vec!["hall", "hall"]] {
        let maps = names.iter().map(|name| served(name, &place)).collect();
        assert!(MapServer::start(session.clone(), maps, ServerOptions::default()).await.is_err());
    }
    session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_query_is_not_answered_after_its_client_has_given_up() {
    let scene = Scene::new().await;
    let request = protocol::encode(Format::Bincode, &scene.request(1, 4)).unwrap();
    let ask_for = async |parameters: &str| {
        let selector = format!("map/hall/match?format=bincode;{parameters}");
        ask(&scene.client, &selector, Some(request.clone()), Some(Format::Bincode.encoding())).await
    };
    for patience in ["patience_ms=60000", "patience_ms=soon", "patience_ms=18446744073709551615"] {
        assert!(ask_for(patience).await[0].is_ok(), "{patience}");
    }
    let answers = ask_for("patience_ms=0").await;
    assert_eq!(only_error(&answers, Format::Bincode).code, ErrorCode::Busy);
    scene.end().await;
}
