//! Laws of matching.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use vision::{
    DescriptorError, DescriptorView, Match, MatchOptions, Metric, distance, match_descriptors, match_grouped,
};

const WIDTH: usize = 4;
const ANYTHING: MatchOptions = MatchOptions { max_distance: f32::MAX, ratio: None, mutual: false };

fn view(bytes: &[u8]) -> DescriptorView<'_> {
    DescriptorView::new(Metric::Hamming, WIDTH, bytes).unwrap()
}

/// Up to 20 short descriptors with few distinct values, so that ties abound.
fn descriptors() -> impl Strategy<Value = Vec<u8>> {
    let short = prop::sample::select(vec![0u8, 1, 3, 7, 0x0f, 0x80, 0xff]);
    (0..20usize).prop_flat_map(move |count| prop::collection::vec(short.clone(), count * WIDTH))
}

fn pairs(matches: &[Match]) -> Vec<(usize, usize)> {
    matches.iter().map(|found| (found.query, found.train)).collect()
}

proptest! {
    #[test]
    fn without_checks_every_query_gets_its_nearest_and_of_equals_the_first(query in descriptors(), train in descriptors()) {
        let found = match_descriptors(view(&query), view(&train), &ANYTHING).unwrap();
        let expected = if train.is_empty() { 0 } else { query.len() / WIDTH };
        prop_assert_eq!(found.len(), expected);
        for Match { query: q, train: t, distance: d } in found {
            for (index, other) in view(&train).iter().enumerate() {
                let rival = distance(Metric::Hamming, view(&query).get(q).unwrap(), other);
                prop_assert!(rival > d || (rival.to_bits() == d.to_bits() && index >= t));
            }
        }
    }

    #[test]
    fn mutual_matching_does_not_care_which_side_asks(a in descriptors(), b in descriptors()) {
        let options = MatchOptions { mutual: true, ..ANYTHING };
        let there = pairs(&match_descriptors(view(&a), view(&b), &options).unwrap());
        let mut back: Vec<_> = match_descriptors(view(&b), view(&a), &options).unwrap()
            .iter().map(|found| (found.train, found.query)).collect();
        back.sort_unstable();
        prop_assert_eq!(there, back);
    }

    #[test]
    fn every_match_beats_its_rivals_by_the_ratio(query in descriptors(), train in descriptors(), ratio in 0.1..1.0f32) {
        let options = MatchOptions { ratio: Some(ratio), ..ANYTHING };
        let found = match_descriptors(view(&query), view(&train), &options).unwrap();
        for all in match_descriptors(view(&query), view(&train), &ANYTHING).unwrap() {
            let own = view(&query).get(all.query).unwrap();
            let clear = view(&train).iter().enumerate().filter(|(index, _)| *index != all.train)
                .all(|(_, other)| all.distance < ratio * distance(Metric::Hamming, own, other));
            prop_assert_eq!(found.contains(&all), clear);
        }
    }

    #[test]
    fn a_stricter_option_only_takes_matches_away(
        query in descriptors(), train in descriptors(), ratio in 0.1..1.0f32, nearer in 0.0..1.0f32,
    ) {
        let loose = pairs(&match_descriptors(view(&query), view(&train), &ANYTHING).unwrap());
        for options in [
            MatchOptions { ratio: Some(ratio), ..ANYTHING },
            MatchOptions { max_distance: nearer, ..ANYTHING },
            MatchOptions { mutual: true, ..ANYTHING },
        ] {
            let strict = match_descriptors(view(&query), view(&train), &options).unwrap();
            prop_assert!(pairs(&strict).iter().all(|pair| loose.contains(pair)));
            prop_assert!(strict.iter().all(|found| found.distance <= options.max_distance));
        }
    }

    /// Seeing a landmark from several keyframes must not make it harder to find.
    #[test]
    fn copies_of_the_same_landmark_are_no_rivals(query in descriptors(), train in descriptors()) {
        let options = MatchOptions { max_distance: 1.0, ratio: Some(0.8), mutual: true };
        let count = (train.len() / WIDTH) as u64;
        let once: Vec<u64> = (0..count).collect();
        let twice = [once.clone(), once.clone()].concat();
        let doubled = train.repeat(2);
        let single = match_grouped(view(&query), view(&train), &once, &options).unwrap();
        let double = match_grouped(view(&query), view(&doubled), &twice, &options).unwrap();
        prop_assert_eq!(single, double);
    }

    #[test]
    fn a_mutual_match_gives_a_landmark_to_one_query_only(query in descriptors(), train in descriptors(), groups in 1..5u64) {
        let numbers: Vec<u64> = (0..(train.len() / WIDTH) as u64).map(|index| index % groups).collect();
        let options = MatchOptions { mutual: true, ..ANYTHING };
        let found = match_grouped(view(&query), view(&train), &numbers, &options).unwrap();
        let mut used: Vec<u64> = found.iter().map(|found| numbers[found.train]).collect();
        used.sort_unstable();
        used.dedup();
        prop_assert_eq!(used.len(), found.len());
    }
}

/// What [`match_grouped`] says, written down as plainly as it can be.
fn plainly(
    query: DescriptorView<'_>,
    train: DescriptorView<'_>,
    groups: &[u64],
    options: &MatchOptions,
) -> Vec<Match> {
    let apart = |q: &[u8], t: &[u8]| distance(query.metric(), q, t);
    let mut matches = Vec::new();
    for (index, own) in query.iter().enumerate() {
        let row: Vec<f32> = train.iter().map(|other| apart(own, other)).collect();
        let Some(best) = (0..row.len()).reduce(|best, next| if row[next] < row[best] { next } else { best })
        else {
            continue;
        };
        let clear = (0..row.len()).filter(|&other| groups[other] != groups[best]);
        let clear =
            options.ratio.is_none_or(|ratio| clear.clone().all(|other| row[best] < ratio * row[other]));
        let of_group = || train.iter().zip(groups).filter(|pair| *pair.1 == groups[best]).map(|pair| pair.0);
        let nearest_to_group =
            |own: &[u8]| of_group().map(|other| apart(own, other)).fold(f32::INFINITY, f32::min);
        let chosen = (0..query.len()).map(|other| nearest_to_group(query.get(other).unwrap())).enumerate();
        let chosen =
            chosen.reduce(|best, next| if next.1 < best.1 { next } else { best }).unwrap().0 == index;
        if row[best] <= options.max_distance && clear && (chosen || !options.mutual) {
            matches.push(Match { query: index, train: best, distance: row[best] });
        }
    }
    matches
}

#[test]
fn signed_bytes_match_exactly_as_defined() {
    let mut random = StdRng::seed_from_u64(9);
    // 1,030 numbers are beyond what `f32` sums hold exactly.
    for (width, largest) in [(1, 2_i8), (3, 3), (64, 4), (64, 127), (128, 127), (1030, 127)] {
        let mut some = |count: usize| -> Vec<u8> {
            let mut bytes: Vec<u8> =
                (0..count * width).map(|_| random.random_range(-largest..=largest).cast_unsigned()).collect();
            bytes[..width].fill(0);
            bytes[width..2 * width].fill(0x80);
            bytes
        };
        let (query, train) = (some(70), [some(40), some(9)].concat());
        let groups: Vec<u64> = (0..49).map(|index| index % 31).collect();
        let alone: Vec<u64> = (0..49).collect();
        let view = |bytes| DescriptorView::new(Metric::CosineInt8, width, bytes).unwrap();
        for mutual in [false, true] {
            for ratio in [None, Some(0.9)] {
                let options = MatchOptions { max_distance: 0.9, ratio, mutual };
                for groups in [&groups, &alone] {
                    let found = match_grouped(view(&query), view(&train), groups, &options).unwrap();
                    assert_eq!(found, plainly(view(&query), view(&train), groups, &options));
                }
            }
        }
    }
}

#[test]
fn copies_of_different_landmarks_are_rivals() {
    let train = [[0x11; WIDTH], [0x11; WIDTH]].concat();
    let options = MatchOptions { ratio: Some(0.8), ..ANYTHING };
    let find =
        |groups: &[u64]| match_grouped(view(&[0x11; WIDTH]), view(&train), groups, &options).unwrap().len();
    assert_eq!(find(&[5, 5]), 1);
    assert_eq!(find(&[5, 6]), 0);
}

/// The defaults on data like the recorded: 256 bits, 9.5 % flips, a third of the queries clutter.
#[test]
fn defaults_find_flipped_descriptors_and_no_clutter() {
    let mut random = StdRng::seed_from_u64(4);
    let train: Vec<u8> = (0..300 * 32).map(|_| random.random()).collect();
    let mut query: Vec<u8> = train[..200 * 32].iter().map(|byte| byte ^ flips(&mut random, 0.095)).collect();
    query.extend((0..100 * 32).map(|_| random.random::<u8>()));
    let view = |bytes| DescriptorView::new(Metric::Hamming, 32, bytes).unwrap();
    let found =
        match_descriptors(view(&query), view(&train), &MatchOptions::for_metric(Metric::Hamming)).unwrap();
    assert!(found.iter().all(|found| found.query == found.train && found.query < 200));
    assert!(found.len() >= 199, "{} of 200", found.len());
}

fn flips(random: &mut StdRng, rate: f64) -> u8 {
    (0..8).map(|bit| u8::from(random.random_bool(rate)) << bit).sum()
}

#[test]
fn a_number_that_is_none_matches_nothing() {
    let bytes: Vec<u8> = [f32::NAN, 1.0].iter().flat_map(|number| number.to_le_bytes()).collect();
    for metric in [Metric::Cosine, Metric::Euclidean] {
        let view = DescriptorView::new(metric, 8, &bytes).unwrap();
        assert!(match_descriptors(view, view, &ANYTHING).unwrap().is_empty());
    }
}

#[test]
fn sets_that_cannot_be_compared_are_refused() {
    let (short, long) = (view(&[0; 4]), DescriptorView::new(Metric::Hamming, 8, &[0; 8]).unwrap());
    let float = DescriptorView::new(Metric::Cosine, 4, &[0; 4]).unwrap();
    assert!(matches!(match_descriptors(short, long, &ANYTHING), Err(DescriptorError::Mismatch { .. })));
    assert!(matches!(match_descriptors(short, float, &ANYTHING), Err(DescriptorError::Mismatch { .. })));
    assert!(matches!(match_grouped(short, short, &[1, 2], &ANYTHING), Err(DescriptorError::Groups { .. })));
}
