//! Why something could not be drawn.

use plotters::drawing::DrawingAreaErrorKind;
use sensors::SequenceError;
use std::path::PathBuf;
use thiserror::Error;

/// An error of the drawing library.
pub(crate) type DrawError = DrawingAreaErrorKind<std::io::Error>;

/// Why a plot could not be drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlotError {
    /// A file of the run or of its ground truth cannot be read.
    #[error(transparent)]
    Input(#[from] SequenceError),
    /// `keyframes.csv` cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// A row of `keyframes.csv` has no position.
    #[error("{}: line {line}: columns 3 to 5 are no position", path.display())]
    Keyframe {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// `events.csv` cannot be understood.
    #[error("{}: {source}", path.display())]
    Events {
        /// The file.
        path: PathBuf,
        /// The reason, with the line.
        source: csv::Error,
    },
    /// `summary.json` cannot be understood.
    #[error("{}: {source}", path.display())]
    Summary {
        /// The file.
        path: PathBuf,
        /// The reason, with the line.
        source: serde_json::Error,
    },
    /// A plot cannot be drawn or written.
    #[error("the plot {} was not written: {source}", path.display())]
    Draw {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl PlotError {
    /// An error of drawing or writing a plot.
    pub(crate) fn draw(
        path: &std::path::Path,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self::Draw { path: path.to_path_buf(), source: source.into() }
    }
}
