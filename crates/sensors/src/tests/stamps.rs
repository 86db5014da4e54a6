//! Stamps of a recorded stream: what is left out, what is sorted, what is a step of the clock.

use crate::stamps::{StampOrder, Step, order};

const MS: i64 = 1_000_000;
const SECOND: i64 = 1000 * MS;
const DAY: i64 = 86_400 * SECOND;
const START_NS: i64 = 1_403_636_625_938_517_094;

/// 16 s of a stream.
fn stream(period_ms: i64) -> Vec<i64> {
    (0..16_000 / period_ms).map(|k| START_NS + k * period_ms * MS).collect()
}

/// The stamps when they were recorded 1 ms later, by a clock of its own.
fn logs(stamps: &[i64]) -> Vec<i64> {
    stamps.iter().map(|ns| ns + 1000 * SECOND + MS).collect()
}

fn numbers(order: &StampOrder) -> Vec<usize> {
    order.outliers.iter().map(|outlier| outlier.index).collect()
}

#[test]
fn few_wrong_stamps_are_left_out_and_all_others_are_as_if_they_were_not_there() {
    let hour = 3600 * SECOND;
    for period_ms in [5, 50, 1000] {
        let right = stream(period_ms);
        let end = right.len() - 1;
        for wrong in [&[0][..], &[1], &[5], &[6, 7], &[2, 9], &[end - 1], &[end], &[end - 1, end], &[0, 1]] {
            for by_ns in [DAY, 365 * DAY, 2 * hour, -2 * hour, -DAY, -30 * 365 * DAY] {
                let mut stamps = right.clone();
                for &index in wrong {
                    stamps[index] += by_ns;
                }
                for logs in [logs(&right), vec![7; right.len()], Vec::new()] {
                    let found = order(&stamps, &logs, &[]);
                    let name =
                        format!("{period_ms} ms, {wrong:?} by {} s, {} logs", by_ns / SECOND, logs.len());
                    assert_eq!(numbers(&found), wrong, "{name}");
                    assert!(
                        found.outliers.iter().all(|outlier| (outlier.ahead_ns > 0) == (by_ns > 0)),
                        "{name}"
                    );
                    let kept = (0..right.len()).filter(|index| !wrong.contains(index));
                    let expected: Vec<_> = kept.map(|index| (right[index], index)).collect();
                    assert_eq!(found.sorted, expected, "{name}");
                    assert!(found.steps.is_empty(), "{name}");
                }
            }
        }
    }
}

#[test]
fn nearer_wrong_stamps_are_found_between_others_and_at_the_ends_by_the_times_of_recording() {
    let right = stream(5);
    for wrong in [0, 400, right.len() - 1] {
        for by_ns in [20 * SECOND, -20 * SECOND] {
            let mut stamps = right.clone();
            stamps[wrong] += by_ns;
            let found = order(&stamps, &logs(&right), &[]);
            assert_eq!(numbers(&found), [wrong], "{wrong}");
            assert_eq!(found.sorted.len(), right.len() - 1);
        }
    }
}

#[test]
fn headers_that_were_not_filled_in_are_left_out() {
    let mut stamps = stream(5);
    stamps[..30].fill(0);
    stamps[700..720].fill(0);
    let found = order(&stamps, &[], &[]);
    assert_eq!(found.outliers.len(), 50);
    assert_eq!(found.sorted.len(), stamps.len() - 50);
}

#[test]
fn what_was_recorded_out_of_order_is_sorted_and_what_came_twice_is_used_once() {
    let right = stream(5);
    let mut reversed: Vec<i64> = right.chunks(4).flat_map(|group| group.iter().rev().copied()).collect();
    let found = order(&reversed, &[], &[]);
    assert!(found.sorted.iter().map(|(ns, _)| *ns).eq(right.iter().copied()));
    assert!(found.outliers.is_empty() && found.out_of_order > right.len() / 2);
    reversed.extend_from_within(..10);
    reversed.sort_unstable();
    let found = order(&reversed, &[], &[]);
    assert_eq!((found.sorted.len(), found.doubled, found.out_of_order), (right.len(), 10, 0));
}

#[test]
fn gaps_and_sparse_streams_are_kept() {
    let mut gaps = stream(5);
    gaps.drain(1000..1200);
    gaps.drain(100..180);
    let sparse: Vec<i64> = (0..20).map(|k| START_NS + (k * k) * SECOND).collect();
    let late: Vec<i64> =
        stream(5).iter().enumerate().map(|(k, ns)| ns + if k > 900 { 1800 * SECOND } else { 0 }).collect();
    for stamps in [gaps, sparse, late, vec![START_NS], vec![START_NS, START_NS + SECOND], Vec::new()] {
        for logs in [logs(&stamps), Vec::new()] {
            let found = order(&stamps, &logs, &[]);
            assert!(found.sorted.iter().map(|(ns, _)| *ns).eq(stamps.iter().copied()));
            assert!(found.outliers.is_empty() && found.steps.is_empty());
        }
    }
}

#[test]
fn from_a_step_back_of_the_clock_the_stamps_go_on_without_it() {
    let right = stream(5);
    let stepped: Vec<i64> =
        right.iter().enumerate().map(|(k, ns)| ns - if k < 800 { 0 } else { 10 * SECOND }).collect();
    let found = order(&stepped, &logs(&right), &[]);
    assert!(found.outliers.is_empty());
    assert_eq!(found.steps.len(), 1);
    assert!((found.steps[0].by_ns + 10 * SECOND).abs() < MS, "{:?}", found.steps);
    assert!(found.sorted.iter().zip(&right).all(|((ns, _), right)| (ns - right).abs() < MS));
    // The images of the same computer take the step of the readings.
    let images: Vec<i64> = stream(50);
    let stepped: Vec<i64> =
        images.iter().enumerate().map(|(k, ns)| ns - if k < 80 { 0 } else { 10 * SECOND }).collect();
    let known = [Step { by_ns: found.steps[0].by_ns + 3, ..found.steps[0] }];
    assert_eq!(order(&stepped, &logs(&images), &known).steps[0].by_ns, known[0].by_ns);
}

#[test]
fn no_stamps_end_the_program() {
    for stamps in [
        &[i64::MAX, i64::MIN, 0, 5, i64::MIN, i64::MAX, i64::MAX, i64::MIN][..],
        &[i64::MIN, i64::MIN, i64::MAX, i64::MAX],
        &[0; 9],
    ] {
        let found = order(stamps, stamps, &[]);
        assert!(found.sorted.len() + found.outliers.len() + found.doubled == stamps.len());
    }
}
