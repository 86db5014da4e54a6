//! Candidates: nobody is served one by default, one decision ends each, and none is made live without the key.

use map::MapContents;
use map::edit::{keyframes_where, remove_keyframes};
use releases::candidates::{newest_open, newest_with_candidates};
use releases::{
    CandidateState, CleanOptions, Note, Outcome, PublishOptions, Release, ReleaseChoice, ReleaseError,
    ReleaseStore, Stage, Verdict, candidate_state, clean, fetch, promote, publish, reject, roll_back,
};
use std::time::Duration;
use tempfile::TempDir;
use testing::{Place, PlaceOptions};

fn scratch() -> (TempDir, ReleaseStore) {
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
    (folder, store)
}

fn note(author: &str, comment: &str) -> Note {
    Note::new(Some(author.to_owned()), Some(comment.to_owned())).unwrap()
}

fn place() -> MapContents {
    let options = PlaceOptions { keyframes: 12, landmarks: 200, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.sort();
    map.info.identity = Some(map.digest());
    map
}

/// Without so many keyframes at its end.
fn without_the_last(count: usize) -> MapContents {
    let mut map = place();
    let first = map.keyframes[map.keyframes.len() - count].id;
    let gone = keyframes_where(&map, |keyframe| keyframe.id >= first);
    remove_keyframes(&mut map, &gone);
    map
}

async fn put(store: &ReleaseStore, map: MapContents, stage: Stage) -> Release {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 6;
    options.stage = stage;
    options.note = note("ada", "racks of aisle 4 moved");
    match publish(store, map, &options, |_| {}).await.unwrap() {
        Outcome::Published(published) => published.release,
        Outcome::Unchanged { number } => panic!("release {number} has it already"),
    }
}

async fn state(store: &ReleaseStore, candidate: u64) -> CandidateState {
    let (proposed, newest) = (store.candidate(candidate).await.unwrap(), store.newest().await.unwrap());
    candidate_state(store, &proposed, newest.as_ref()).await.unwrap()
}

#[tokio::test]
async fn a_candidate_is_live_when_it_is_promoted_and_not_before() {
    let (_folder, store) = scratch();
    let live = put(&store, place(), Stage::Live).await;
    let proposed = put(&store, without_the_last(1), Stage::Candidate).await;
    assert_eq!(
        (proposed.candidate, proposed.number, proposed.map.version),
        (Some(1), 2, live.map.version + 1)
    );
    assert_eq!((store.numbers().await.unwrap(), store.newest().await.unwrap()), (vec![1], Some(live)));
    assert_eq!(newest_open(&store).await.unwrap(), proposed);
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), proposed);

    let promoted = promote(&store, 1, &note("bob", "drives of Monday agree")).await.unwrap();
    assert_eq!(store.newest().await.unwrap().unwrap(), promoted);
    let expected = Release {
        stage: Stage::Live,
        published_unix_s: promoted.published_unix_s,
        promotion: Some(note("bob", "drives of Monday agree")),
        ..proposed.clone()
    };
    assert_eq!(promoted, expected);
    assert_eq!(promoted.note.author.as_deref(), Some("ada"));
    assert_eq!(fetch(&store, &promoted, None).await.unwrap().digest(), proposed.digest);
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), promoted);
    // Once more is no error, and changes nothing.
    assert_eq!(promote(&store, 1, &Note::default()).await.unwrap(), promoted);
    let error = reject(&store, 1, &Note::default()).await.unwrap_err();
    assert_eq!(error.to_string(), "candidate 1 was promoted before by bob");
    assert!(matches!(state(&store, 1).await, CandidateState::Promoted(_)));
    let next = put(&store, without_the_last(2), Stage::Live).await;
    assert!(next.number == 3 && next.map.version > promoted.map.version && next.candidate.is_none());
}

#[tokio::test]
async fn a_rejected_candidate_leads_back_to_the_live_map_with_a_version_of_its_own() {
    let (_folder, store) = scratch();
    let live = put(&store, place(), Stage::Live).await;
    let proposed = put(&store, without_the_last(1), Stage::Candidate).await;
    let decision = reject(&store, 1, &note("bob", "aisle 4 is 0.3 m off")).await.unwrap();
    assert_eq!((decision.candidate, decision.verdict), (1, Verdict::Rejected));
    assert_eq!(state(&store, 1).await, CandidateState::Rejected(decision));
    for again in [
        promote(&store, 1, &Note::default()).await.map(drop),
        reject(&store, 1, &Note::default()).await.map(drop),
    ] {
        assert!(matches!(again, Err(ReleaseError::Decided { verdict: Verdict::Rejected, .. })), "{again:?}");
    }
    let back = newest_with_candidates(&store).await.unwrap().unwrap();
    assert_eq!((back.digest, back.number), (live.digest, live.number));
    assert!(back.map.version > proposed.map.version);
    assert!(matches!(newest_open(&store).await, Err(ReleaseError::NoCandidate { candidate: None, .. })));
    // Whatever comes next has a version that no robot has seen.
    let second = put(&store, without_the_last(1), Stage::Candidate).await;
    assert!(second.candidate == Some(2) && second.map.version > back.map.version);
    let next = put(&store, without_the_last(2), Stage::Live).await;
    assert!(next.map.version > second.map.version + 1);
    let rolled = roll_back(&store, 1, &note("bob", "as before")).await.unwrap();
    let Outcome::Published(rolled) = rolled else { panic!("nothing changed") };
    assert_eq!(rolled.release.note, note("bob", "as before"));
}

#[tokio::test]
async fn a_candidate_that_was_overtaken_is_not_promoted() {
    let (_folder, store) = scratch();
    put(&store, place(), Stage::Live).await;
    put(&store, without_the_last(1), Stage::Candidate).await;
    let live = put(&store, without_the_last(2), Stage::Live).await;
    let error = promote(&store, 1, &Note::default()).await.unwrap_err();
    assert!(matches!(error, ReleaseError::Overtaken { candidate: 1, number: 2, newest: 2 }), "{error}");
    assert_eq!(state(&store, 1).await, CandidateState::Overtaken { by: 2 });
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), live);
}

#[tokio::test]
async fn where_an_older_candidate_is_promoted_versions_grow_all_the_same() {
    let (_folder, store) = scratch();
    put(&store, place(), Stage::Live).await;
    let older = put(&store, without_the_last(1), Stage::Candidate).await;
    let newer = put(&store, without_the_last(2), Stage::Candidate).await;
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), newer);
    let promoted = promote(&store, 1, &Note::default()).await.unwrap();
    assert!(promoted.map.version == older.map.version && older.map.version < newer.map.version);
    let followed = newest_with_candidates(&store).await.unwrap().unwrap();
    assert_eq!((followed.digest, followed.number), (promoted.digest, promoted.number));
    assert_eq!(followed.map.version, newer.map.version + 1);
    // It stays so, and whatever comes next has a version that no robot has seen.
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), followed);
    let next = put(&store, without_the_last(3), Stage::Candidate).await;
    assert!(next.map.version > followed.map.version);
    assert_eq!(newest_with_candidates(&store).await.unwrap().unwrap(), next);
}

#[tokio::test]
async fn of_a_promotion_and_a_rejection_at_once_one_counts() {
    for _ in 0..10 {
        let (_folder, store) = scratch();
        put(&store, place(), Stage::Live).await;
        put(&store, without_the_last(1), Stage::Candidate).await;
        let (one, other) = (Note::default(), Note::default());
        let (promoted, rejected) = tokio::join!(promote(&store, 1, &one), reject(&store, 1, &other));
        assert!(promoted.is_ok() != rejected.is_ok(), "{promoted:?} {rejected:?}");
        assert_eq!(store.numbers().await.unwrap().len(), 1 + usize::from(promoted.is_ok()));
    }
}

#[tokio::test]
async fn a_promotion_that_was_killed_is_ended_by_promoting_again() {
    let (folder, store) = scratch();
    put(&store, place(), Stage::Live).await;
    put(&store, without_the_last(1), Stage::Candidate).await;
    promote(&store, 1, &note("bob", "first")).await.unwrap();
    // As if the program had ended between the decision and the release.
    std::fs::remove_file(folder.path().join("releases/00000000000000000002.json")).unwrap();
    assert!(matches!(state(&store, 1).await, CandidateState::Promoted(_)));
    assert!(matches!(reject(&store, 1, &Note::default()).await, Err(ReleaseError::Decided { .. })));
    assert_eq!(promote(&store, 1, &note("bob", "again")).await.unwrap().number, 2);
}

#[tokio::test]
async fn cleaning_keeps_what_may_be_promoted() {
    let (_folder, store) = scratch();
    let mut options = CleanOptions::default();
    (options.releases, options.grace) = (1, Duration::ZERO);
    put(&store, place(), Stage::Live).await;
    put(&store, without_the_last(3), Stage::Candidate).await;
    put(&store, without_the_last(1), Stage::Live).await;
    let proposed = put(&store, without_the_last(2), Stage::Candidate).await;
    // Segments that were put in this second count as young.
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let cleaned = clean(&store, &options).await.unwrap();
    assert_eq!((cleaned.releases, cleaned.candidates), (vec![1], vec![1]));
    assert!(!cleaned.segments.is_empty());
    assert_eq!(fetch(&store, &proposed, None).await.unwrap().digest(), proposed.digest);
    let promoted = promote(&store, 2, &Note::default()).await.unwrap();
    assert_eq!(fetch(&store, &promoted, None).await.unwrap().digest(), proposed.digest);
    let again = clean(&store, &options).await.unwrap();
    assert_eq!((again.releases, again.candidates), (vec![2], vec![]), "the newest number never comes again");
}

#[tokio::test]
async fn errors_name_a_candidate_as_one() {
    let (folder, store) = scratch();
    put(&store, place(), Stage::Live).await;
    let proposed = put(&store, without_the_last(1), Stage::Candidate).await;
    let [one, two] = [1, 2].map(|number| folder.path().join(format!("candidates/{number:020}.json")));
    std::fs::copy(one, two).unwrap();
    let error = store.candidate(2).await.unwrap_err().to_string();
    assert!(error.contains("it says that it is candidate 1"), "{error}");
    let other = Release { digest: protocol::MapIdentity::from_bytes([7; 16]), ..proposed };
    let error = fetch(&store, &other, None).await.unwrap_err().to_string();
    assert!(error.contains("candidate 1 is damaged"), "{error}");
}

#[cfg(feature = "signing")]
#[tokio::test]
async fn without_the_key_no_candidate_is_made_live_and_none_is_rejected() {
    use releases::{ReleaseKey, SigningKey};

    let keys = tempfile::tempdir().unwrap();
    let secret = keys.path().join("city.key");
    let public = SigningKey::generate(&secret).unwrap();
    let (folder, store) = scratch();
    let signing = store.clone().signing_with(SigningKey::read(&secret, None).unwrap());
    let key: ReleaseKey = public.to_str().unwrap().parse().unwrap();
    let verifying = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap().signed_with(key);
    put(&signing, place(), Stage::Live).await;
    let proposed = put(&signing, without_the_last(1), Stage::Candidate).await;
    assert_eq!(newest_with_candidates(&verifying).await.unwrap().unwrap(), proposed);

    // Its file, which is signed, does not make it live.
    let [candidate, live] = ["candidates/00000000000000000001.json", "releases/00000000000000000002.json"]
        .map(|name| folder.path().join(name));
    std::fs::copy(&candidate, &live).unwrap();
    let error = verifying.newest().await.unwrap_err().to_string();
    assert!(error.contains("it is candidate"), "{error}");
    let text = std::fs::read_to_string(&candidate).unwrap();
    std::fs::write(&live, text.replace("\"candidate\",", "\"live\",")).unwrap();
    assert!(matches!(verifying.newest().await, Err(ReleaseError::NotSigned { .. })));
    std::fs::remove_file(&live).unwrap();
    // Nor is somebody else's comment taken for the publisher's.
    std::fs::write(&candidate, text.replace("aisle 4", "aisle 5")).unwrap();
    assert!(matches!(verifying.candidate(1).await, Err(ReleaseError::NotSigned { .. })));
    std::fs::write(&candidate, &text).unwrap();
    // A rejection without the key is not believed, and stands in the way of nothing else than deciding.
    reject(&store, 1, &note("mallory", "no")).await.unwrap();
    let error = newest_with_candidates(&verifying).await.unwrap_err();
    assert!(matches!(error, ReleaseError::NotSigned { .. }), "{error}");
    std::fs::remove_dir_all(folder.path().join("decisions")).unwrap();
    let promoted = promote(&signing, 1, &note("bob", "agreed")).await.unwrap();
    assert_eq!(verifying.newest().await.unwrap().unwrap(), promoted);
}

#[cfg(feature = "signing")]
#[tokio::test]
async fn nothing_is_signed_anew_that_the_key_did_not_sign_before() {
    use releases::SigningKey;

    let keys = tempfile::tempdir().unwrap();
    let (folder, store) = scratch();
    let [ours, theirs] = ["ours", "theirs"].map(|name| {
        let file = keys.path().join(name);
        SigningKey::generate(&file).unwrap();
        store.clone().signing_with(SigningKey::read(&file, None).unwrap())
    });
    put(&store, place(), Stage::Live).await;
    put(&theirs, without_the_last(1), Stage::Live).await;
    let signed = put(&ours, without_the_last(2), Stage::Live).await;
    put(&store, without_the_last(3), Stage::Candidate).await;
    put(&theirs, without_the_last(3), Stage::Candidate).await;
    let nobody = Note::default();
    for (refused, choice) in [
        (promote(&ours, 1, &nobody).await.map(drop), "@candidate-1 "),
        (promote(&ours, 2, &nobody).await.map(drop), "@candidate-2 "),
        (roll_back(&ours, 1, &nobody).await.map(drop), "@1 "),
        (roll_back(&ours, 2, &nobody).await.map(drop), "@2 "),
    ] {
        let error = refused.unwrap_err();
        assert!(matches!(error, ReleaseError::SourceNotSigned { .. }), "{error}");
        let said = error.to_string();
        assert!(said.contains(choice) && said.contains("publish it with --sign"), "{said}");
    }
    assert_eq!(store.newest().await.unwrap(), Some(signed));
    assert!(!folder.path().join("decisions").exists(), "nothing was decided");
    // What nobody signs is promoted as before, and what the key signed is, too.
    assert_eq!(promote(&store, 1, &nobody).await.unwrap().number, 4);
    let back = roll_back(&ours, 3, &nobody).await.unwrap();
    assert!(matches!(back, Outcome::Published(_)), "{back:?}");
    let proposed = put(&ours, without_the_last(1), Stage::Candidate).await;
    assert_eq!(promote(&ours, 3, &nobody).await.unwrap().digest, proposed.digest);
}

#[test]
fn a_choice_is_read_as_it_is_written() {
    for choice in [
        ReleaseChoice::Newest,
        ReleaseChoice::Number(7),
        ReleaseChoice::NewestCandidate,
        ReleaseChoice::Candidate(3),
    ] {
        assert_eq!(choice.to_string().parse(), Ok(choice));
    }
    for wrong in ["", "0", "candidate-", "candidate-0", "candidate3", "newest"] {
        assert!(wrong.parse::<ReleaseChoice>().is_err(), "{wrong}");
    }
}
