//! How the matches of an extractor's features are to be taken: it differs how distinct its descriptors are, and how often matches agree
//! with a wrong pose by accident.
//!
//! Measured by the example `place_evidence` in rendered warehouses that repeat their pictures, see "Evidence by extractor" in the
//! book's page on adaptation.

use vision::MatchOptions;

/// What matching and evidence of places depend on, by the extractor of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExtractorStatistics {
    /// Ratio test of matches with a keyframe, see [`MatchOptions::ratio`]; `None` for that of the metric.
    ratio: Option<f32>,
    /// Inliers confirm a part of an image up to this reprojection error from the claimed pose, as an angle (rad).
    pub(crate) confirming_angle: f64,
    /// Chance that a repeated picture confirms another part beyond it, one after the other: by matches that agree by accident, and
    /// because what repeats is larger.
    pub(crate) chance_beyond: f64,
}

/// Gradient histograms, descriptors of the recorded features, and those of extractors that were not measured. Of 687 wrong places that
/// were verified in rendered warehouses 15 % had one part confirmed beyond the picture, 4 % two or more. The inliers of wrong places that were
/// claimed fit half as well as those of right ones: beyond half a degree they do not count.
const CLASSICAL: ExtractorStatistics =
    ExtractorStatistics { ratio: None, confirming_angle: 0.009, chance_beyond: 0.3 };

/// EdgePoint2. Its descriptors show structure more than texture, and structure repeats along racks and walls: of wrong places more
/// parts are confirmed beyond the picture, by matches that fit within the error of an inlier only. Beyond 0.4 deg they do not count.
const EDGEPOINT2: ExtractorStatistics =
    ExtractorStatistics { ratio: Some(0.7), confirming_angle: 0.007, chance_beyond: 0.4 };

/// XFeat, of whose wrong places more parts are confirmed beyond the picture as well.
const XFEAT: ExtractorStatistics =
    ExtractorStatistics { ratio: None, confirming_angle: f64::INFINITY, chance_beyond: 0.4 };

impl ExtractorStatistics {
    /// Of an extractor, by its name with its version, like `edgepoint2-1`.
    pub(crate) fn of(extractor: &str) -> Self {
        match extractor.split_once('-').map_or(extractor, |(family, _)| family) {
            "edgepoint2" => EDGEPOINT2,
            "xfeat" => XFEAT,
            _ => CLASSICAL,
        }
    }

    /// Conditions on matches of an image with a keyframe.
    ///
    /// # Arguments
    /// * `of_metric`: the defaults for the descriptors' metric.
    pub(crate) fn match_options(&self, of_metric: MatchOptions) -> MatchOptions {
        MatchOptions { ratio: self.ratio.or(of_metric.ratio), ..of_metric }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vision::Metric;

    #[test]
    fn extractors_that_were_not_measured_are_taken_as_classical_ones() {
        for name in ["sift-1", "", "r2d2-1", "edgepoint", "edgepoint2m-1", "my-edgepoint2"] {
            assert_eq!(ExtractorStatistics::of(name), CLASSICAL, "{name}");
        }
        for name in ["edgepoint2-1", "edgepoint2-2", "edgepoint2"] {
            assert_eq!(ExtractorStatistics::of(name), EDGEPOINT2, "{name}");
        }
        assert_eq!(ExtractorStatistics::of("xfeat-1"), XFEAT);
    }

    #[test]
    fn only_the_ratio_differs_from_the_defaults_of_the_metric() {
        for metric in [Metric::Hamming, Metric::CosineInt8] {
            let of_metric = MatchOptions::for_metric(metric);
            assert!(
                [CLASSICAL, XFEAT].iter().all(|statistics| statistics.match_options(of_metric) == of_metric)
            );
            assert_eq!(EDGEPOINT2.match_options(of_metric), MatchOptions { ratio: Some(0.7), ..of_metric });
        }
    }
}
