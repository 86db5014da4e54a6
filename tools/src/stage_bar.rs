//! The progress bar of map building.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use mapping::Stage;

/// A bar that names the stage it shows.
pub struct StageBar {
    bar: ProgressBar,
    stage: Option<Stage>,
}

impl StageBar {
    /// A bar, or none that is seen.
    pub fn new(hidden: bool) -> StageBar {
        if hidden {
            return StageBar { bar: ProgressBar::hidden(), stage: None };
        }
        let bar = ProgressBar::new(0);
        if let Ok(style) = ProgressStyle::with_template("{msg:>9} [{wide_bar}] {pos}/{len} {elapsed_precise}")
        {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        StageBar { bar, stage: None }
    }

    /// Shows how far a stage is.
    pub fn show(&mut self, stage: Stage, done: usize, all: usize) {
        if self.stage != Some(stage) {
            self.bar.set_message(stage.label());
            self.stage = Some(stage);
        }
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
