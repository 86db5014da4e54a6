//! The camera folders: which images there are, what was tracked in them, and what a place-recognition extractor saw.

use super::error::SequenceError;
use super::table::{Row, Table, check_order};
use crate::estimator::TrackObservation;
use nalgebra::Vector2;
use protocol::{DescriptorFormat, DescriptorKind, FeatureSet};
use std::path::{Path, PathBuf};

/// One instant at which the cameras looked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The image files of camera 0 and 1, where the recording has them.
    pub images: [Option<PathBuf>; 2],
    /// What was tracked, camera 0 first; empty where the front end saw nothing or did not run.
    pub tracks: Vec<TrackObservation>,
    /// What a place-recognition extractor saw in camera 0, if it ran on this image.
    pub features: Option<FeatureSet>,
}

/// The images that a camera's `data.csv` lists, in order of time.
#[derive(Debug, Default)]
pub(crate) struct ImageList {
    /// When they were taken, nanoseconds.
    pub(crate) stamps: Vec<i64>,
    /// Their files, in the same order; empty for a recording without images.
    pub(crate) files: Vec<PathBuf>,
}

/// Reads which images a camera took. Where there is a folder `data`, each of them must be in it.
pub(crate) fn read_images(folder: &Path) -> Result<ImageList, SequenceError> {
    let path = folder.join("data.csv");
    let mut table = Table::open(&path, "it lists the time stamps of this camera's images")?;
    let image_folder = folder.join("data");
    let with_images = image_folder.is_dir();
    let mut images = ImageList::default();
    while let Some(row) = table.next_row()? {
        let stamp_ns = row.stamp()?;
        check_order(&row, images.stamps.last().copied(), stamp_ns)?;
        images.stamps.push(stamp_ns);
        if with_images {
            images.files.push(image_file(&row, &image_folder)?);
        }
    }
    if images.stamps.is_empty() {
        return Err(SequenceError::empty(&path, "list the images as `timestamp [ns],filename`"));
    }
    Ok(images)
}

/// The file of a row of `data.csv`, which must be there.
fn image_file(row: &Row<'_>, folder: &Path) -> Result<PathBuf, SequenceError> {
    let name = String::from_utf8_lossy(row.cell(1)?).into_owned();
    let file = folder.join(&name);
    if name.is_empty() || !file.is_file() {
        return Err(row.wrong(format!(
            "the image {} is not there: copy it again or delete the row (without a folder {} the recording is read as \
             one without images)",
            file.display(),
            folder.display()
        )));
    }
    Ok(file)
}

/// Hands a camera's images to the frames.
pub(crate) fn place_images(images: &ImageList, camera: usize, frames: &mut [Frame]) {
    let mut at = 0;
    for (stamp_ns, file) in images.stamps.iter().zip(&images.files) {
        while frames[at].stamp_ns < *stamp_ns {
            at += 1;
        }
        frames[at].images[camera] = Some(file.clone());
    }
}

/// The frames of all cameras, empty yet: every stamp that any of them has.
pub(crate) fn empty_frames(cameras: &[ImageList]) -> Vec<Frame> {
    let mut all: Vec<i64> = cameras.iter().flat_map(|images| &images.stamps).copied().collect();
    all.sort_unstable();
    all.dedup();
    all.into_iter().map(|stamp_ns| Frame { stamp_ns, ..Frame::default() }).collect()
}

/// Walks through a camera's stamps and all frames, side by side with a table that is sorted by time.
struct FrameCursor<'a> {
    stamps: &'a [i64],
    stamp: usize,
    frame: usize,
}

impl<'a> FrameCursor<'a> {
    fn new(stamps: &'a [i64]) -> Self {
        Self { stamps, stamp: 0, frame: 0 }
    }

    /// The frame that a row belongs to.
    fn seek(&mut self, row: &Row<'_>, frames: &[Frame]) -> Result<usize, SequenceError> {
        let stamp_ns = row.stamp()?;
        let current = self.stamps.get(self.stamp).copied();
        if current.is_some_and(|current| stamp_ns < current) && self.stamp > 0 {
            return Err(row.wrong(format!("time stamp {stamp_ns} goes back in time: sort the file by time")));
        }
        while self.stamps.get(self.stamp).is_some_and(|stamp| *stamp < stamp_ns) {
            self.stamp += 1;
        }
        if self.stamps.get(self.stamp) != Some(&stamp_ns) {
            return Err(row.wrong(format!(
                "time stamp {stamp_ns} is not in this camera's data.csv: list the image there, or delete the row"
            )));
        }
        while frames[self.frame].stamp_ns < stamp_ns {
            self.frame += 1;
        }
        Ok(self.frame)
    }
}

/// Reads `tracks.csv` into the frames, if the camera has one.
pub(crate) fn read_tracks(
    folder: &Path,
    camera: u8,
    stamps: &[i64],
    frames: &mut [Frame],
) -> Result<(), SequenceError> {
    let path = folder.join("tracks.csv");
    if !path.exists() {
        return Ok(());
    }
    let mut table = Table::open(&path, "it holds the tracked features")?;
    let mut cursor = FrameCursor::new(stamps);
    let mut seen = SeenIds::default();
    while let Some(row) = table.next_row()? {
        row.require(4)?;
        let index = cursor.seek(&row, frames)?;
        let feature_id = row.parse(1)?;
        let pixel = Vector2::new(row.finite(2)?, row.finite(3)?);
        if !seen.insert(index, feature_id) {
            return Err(row.wrong(format!(
                "feature {feature_id} appears twice in this image: a track has one pixel an image, delete one"
            )));
        }
        frames[index].tracks.push(TrackObservation { camera, feature_id, pixel });
    }
    Ok(())
}

/// The ids seen in the current image.
#[derive(Default)]
struct SeenIds {
    frame: usize,
    ids: std::collections::HashSet<u64>,
}

impl SeenIds {
    fn insert(&mut self, frame: usize, id: u64) -> bool {
        if frame != self.frame {
            self.frame = frame;
            self.ids.clear();
        }
        self.ids.insert(id)
    }
}

/// Reads `features.csv` into the frames, if the camera has one.
pub(crate) fn read_features(
    folder: &Path,
    stamps: &[i64],
    frames: &mut [Frame],
) -> Result<(), SequenceError> {
    let path = folder.join("features.csv");
    if !path.exists() {
        return Ok(());
    }
    let mut table = Table::open(&path, "it holds the features for place recognition")?;
    let mut cursor = FrameCursor::new(stamps);
    let mut width = None;
    while let Some(row) = table.next_row()? {
        row.require(4)?;
        let index = cursor.seek(&row, frames)?;
        let pixel = [row.finite(1)? as f32, row.finite(2)? as f32];
        let hex = row.cell(3)?;
        let set = frames[index].features.get_or_insert_with(|| empty_features((hex.len() / 2) as u16));
        let bytes_before = set.descriptors.bytes.len();
        decode_hex(&row, hex, &mut set.descriptors.bytes)?;
        let bytes = set.descriptors.bytes.len() - bytes_before;
        if bytes != *width.get_or_insert(bytes) || bytes > usize::from(u16::MAX) {
            return Err(row.wrong(format!(
                "the descriptor has {bytes} bytes, those before have {}: the row is cut off, or the file mixes kinds",
                width.unwrap_or_default()
            )));
        }
        set.pixels.push(pixel);
    }
    Ok(())
}

fn empty_features(width: u16) -> FeatureSet {
    FeatureSet::empty(DescriptorFormat { kind: DescriptorKind::Binary, width })
}

fn decode_hex(row: &Row<'_>, hex: &[u8], bytes: &mut Vec<u8>) -> Result<(), SequenceError> {
    if hex.is_empty() || !hex.len().is_multiple_of(2) {
        return Err(row.wrong(format!(
            "the descriptor has {} hexadecimal digits, which is no whole number of bytes: the row is cut off",
            hex.len()
        )));
    }
    for pair in hex.chunks_exact(2) {
        let digits = (char::from(pair[0]).to_digit(16), char::from(pair[1]).to_digit(16));
        let (Some(high), Some(low)) = digits else {
            let text = String::from_utf8_lossy(pair);
            return Err(row.wrong(format!("\"{text}\" in the descriptor is not hexadecimal")));
        };
        bytes.push((high * 16 + low) as u8);
    }
    Ok(())
}
