//! The progress bar of map building.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use mapping::Stage;

/// A bar that names the stage it shows and knows how long each took.
pub struct StageBar {
    bar: ProgressBar,
    seconds: Vec<(Stage, f64)>,
    now: Option<(Stage, Instant)>,
}

impl StageBar {
    /// A bar, or none that is seen.
    pub fn new(hidden: bool) -> StageBar {
        let bar = if hidden { ProgressBar::hidden() } else { visible() };
        StageBar { bar, seconds: Vec::new(), now: None }
    }

    /// Shows how far a stage is.
    pub fn show(&mut self, stage: Stage, done: usize, all: usize) {
        if self.now.is_none_or(|(now, _)| now != stage) {
            self.leave();
            self.now = Some((stage, Instant::now()));
            self.bar.set_message(stage.label());
        }
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
    }

    /// Removes the bar.
    ///
    /// # Returns
    /// How long each stage took, in a line.
    pub fn finish(mut self) -> String {
        self.leave();
        self.bar.finish_and_clear();
        let stage = |(stage, seconds): &(Stage, f64)| format!("{} {seconds:.1} s", stage.label());
        self.seconds.iter().map(stage).collect::<Vec<_>>().join(", ")
    }

    fn leave(&mut self) {
        let Some((stage, begin)) = self.now.take() else { return };
        let seconds = begin.elapsed().as_secs_f64();
        match self.seconds.iter_mut().find(|(known, _)| *known == stage) {
            Some((_, sum)) => *sum += seconds,
            None => self.seconds.push((stage, seconds)),
        }
    }
}

fn visible() -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{msg:>9} [{wide_bar}] {pos}/{len} {elapsed_precise}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
