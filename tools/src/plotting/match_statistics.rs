//! Below the images of [`super::matches`]: histograms of reprojection errors and descriptor distances, and the other
//! candidates.

use recognition::{InspectedKeyframe, InspectedMatch, Inspection};

/// Bars of a histogram.
const BINS: usize = 24;
/// Candidates that are listed.
const LISTED: usize = 7;
/// The histogram of errors ends at this multiple of the gate; what is beyond counts in the last bar.
const GATES: f64 = 2.0;

/// Inliers and the other matches by some quantity, stacked.
pub(super) struct Histogram {
    /// Inliers and others of each bar.
    pub(super) counts: [(usize, usize); BINS],
    /// At zero and each quarter of the axis but the last.
    pub(super) labels: [String; 4],
    /// At the end of the axis.
    pub(super) end: String,
}

impl Histogram {
    fn new(
        keyframe: &InspectedKeyframe,
        reach: f64,
        value: impl Fn(&InspectedMatch) -> f64,
        label: impl Fn(f64) -> String,
    ) -> Self {
        let mut counts = [(0, 0); BINS];
        for found in &keyframe.matches {
            // An infinite value is cast to the largest number, and falls into the last bar.
            let bar = (value(found) / reach * BINS as f64) as usize;
            let (inliers, others) = &mut counts[bar.min(BINS - 1)];
            *(if found.inlier { inliers } else { others }) += 1;
        }
        let labels = [0.0, 1.0, 2.0, 3.0].map(|quarter| label(reach * quarter / 4.0));
        Self { counts, labels, end: label(reach) }
    }

    /// The highest bar, at least 1.
    pub(super) fn highest(&self) -> usize {
        self.counts.iter().map(|(inliers, others)| inliers + others).max().unwrap_or(0).max(1)
    }
}

/// Reprojection errors of the matches, px.
pub(super) fn errors(keyframe: &InspectedKeyframe) -> Histogram {
    let reach = GATES * keyframe.gate_px;
    let error = |found: &InspectedMatch| found.error_px().unwrap_or(f64::INFINITY);
    let errors = Histogram::new(keyframe, reach, error, |value| format!("{value:.0}"));
    Histogram { end: format!("\u{2265} {reach:.0}"), ..errors }
}

/// Descriptor distances of the matches.
pub(super) fn distances(keyframe: &InspectedKeyframe) -> Histogram {
    let distance = |found: &InspectedMatch| f64::from(found.distance);
    let largest = keyframe.matches.iter().map(distance).fold(0.0, f64::max);
    let reach = if largest > 0.0 { largest } else { 1.0 };
    Histogram::new(keyframe, reach, distance, |value| format!("{value:.2}"))
}

/// A candidate as it is listed.
pub(super) struct Candidate {
    pub(super) id: u64,
    /// Whether it is the one in the picture.
    pub(super) is_shown: bool,
    pub(super) matches: usize,
    pub(super) inliers: usize,
    pub(super) verdict: &'static str,
}

/// The best candidates.
pub(super) fn list_candidates(inspection: &Inspection, shown: &InspectedKeyframe) -> Vec<Candidate> {
    let listed = inspection.keyframes.iter().take(LISTED);
    let candidate = |keyframe: &InspectedKeyframe| Candidate {
        id: keyframe.id,
        is_shown: keyframe.id == shown.id,
        matches: keyframe.matches.len(),
        inliers: keyframe.inliers(),
        verdict: describe_verdict(keyframe),
    };
    listed.map(candidate).collect()
}

/// The result of the comparison with a keyframe.
pub fn describe_verdict(keyframe: &InspectedKeyframe) -> &'static str {
    keyframe.verdict.describe(keyframe.in_answer)
}
