//! Which keyframes of a map could be taken for another place of it.

use indicatif::ProgressBar;
use map::contents::MapContents;
use protocol::KeyframeId;
use recognition::{LoadedMap, RecognitionOptions};
use serde::Serialize;

/// How much of a map looks like other parts of it.
#[derive(Serialize)]
pub struct MapAliases {
    /// Views of the map that do not overlap, as far as they were sampled for the rate.
    pub views: f64,
    /// Those of them that another place explains as well.
    pub aliased_views: f64,
    /// Natural logarithm of the odds of the right place over one that looks alike, before an image is seen.
    pub log_prior_odds: f64,
    /// All keyframes that could be taken for another place.
    pub keyframes: Vec<AliasedKeyframe>,
}

/// A keyframe that could be taken for another place.
#[derive(Serialize)]
pub struct AliasedKeyframe {
    /// Its id.
    pub keyframe: KeyframeId,
    /// Where it is in G, m.
    pub position_m: [f64; 3],
    /// Where its image could be taken to be from, m.
    pub other_position_m: [f64; 3],
    /// Features of it that landmarks of the other place explain.
    pub features: usize,
    /// Natural logarithm of the odds of the other place by its image alone.
    pub log_odds: f64,
}

impl MapAliases {
    /// Compares each keyframe of a map with all others.
    ///
    /// # Errors
    /// Contents that are not a map.
    pub fn of(contents: MapContents, bar: &ProgressBar) -> anyhow::Result<Self> {
        let map = LoadedMap::from_contents(contents)?;
        let options = RecognitionOptions::default();
        let rate = map.aliasing_rate();
        let mut keyframes = Vec::new();
        bar.set_length(map.keyframe_count() as u64);
        for keyframe in map.keyframes() {
            let places = map.aliases(keyframe.id, &options)?;
            if let Some(other) = places.first().filter(|place| place.log_odds() >= options.min_log_odds) {
                keyframes.push(AliasedKeyframe {
                    keyframe: keyframe.id,
                    position_m: keyframe.global_from_keyframe.pose.translation.into(),
                    other_position_m: other.place.global_from_camera.pose.translation.into(),
                    features: other.place.features,
                    log_odds: other.log_odds(),
                });
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(Self {
            views: rate.views,
            aliased_views: rate.aliased,
            log_prior_odds: rate.log_odds(),
            keyframes,
        })
    }

    /// Prints them as lines of a summary.
    pub fn print(&self) {
        println!(
            "aliasing                 {:.1} of {:.1} views look like another place; odds of an answer {:.1}, before the image is \
             seen",
            self.aliased_views,
            self.views,
            self.log_prior_odds.exp()
        );
        println!("  aliased keyframes      {}", self.keyframes.len());
        for aliased in &self.keyframes {
            let [x, y, z] = aliased.position_m;
            let [other_x, other_y, other_z] = aliased.other_position_m;
            println!(
                "  {:<22} at ({x:.2}, {y:.2}, {z:.2}) m could be at ({other_x:.2}, {other_y:.2}, {other_z:.2}) m: {} features",
                aliased.keyframe, aliased.features
            );
        }
    }
}
