//! The camera folders: images, tracks and features, merged into frames.

use super::stamps::{FrameStamps, TableStamps};
use crate::row_order::RowOrder;
use crate::table::{Row, Table, check_order};
use crate::{Frame, ImageData, SequenceError, TrackObservation};
use nalgebra::Vector2;
use protocol::{DescriptorFormat, DescriptorKind, FeatureSet};
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Iterates over the frames of all cameras. Ends with the first error.
pub(crate) struct FrameRows {
    cameras: Vec<CameraRows>,
    stamps: Arc<FrameStamps>,
    /// Number of the next frame.
    next: usize,
    ended: bool,
}

impl FrameRows {
    /// Opens the tables of the cameras whose stamps were read.
    pub(super) fn open(mav: &Path, stamps: &Arc<FrameStamps>) -> Result<Self, SequenceError> {
        let open = |(camera, images): (usize, &TableStamps)| {
            CameraRows::open(&mav.join(format!("cam{camera}")), camera as u8, images)
        };
        let cameras = stamps.images.iter().enumerate().map(open).collect::<Result<_, _>>()?;
        Ok(Self { cameras, stamps: Arc::clone(stamps), next: 0, ended: false })
    }

    fn read_next(&mut self) -> Result<Option<Frame>, SequenceError> {
        let stamps = Arc::clone(&self.stamps);
        let Some(joined) = stamps.frames.get(self.next) else {
            for camera in &mut self.cameras {
                camera.skip_to(i64::MAX)?;
                camera.expect_end()?;
            }
            return Ok(None);
        };
        self.next += 1;
        let mut frame = Frame { stamp_ns: joined.stamp_ns, ..Frame::default() };
        let images = joined.images.iter().zip(&stamps.images);
        for (camera, (number, table)) in self.cameras.iter_mut().zip(images) {
            let Some(image_ns) = number.map(|number| table.used[number]) else { continue };
            camera.skip_to(image_ns)?;
            if camera.image_ns != Some(image_ns) {
                return Err(camera.images.row().wrong("the file was changed while it was read: start again"));
            }
            camera.read_into(&mut frame)?;
        }
        Ok(Some(frame))
    }
}

impl Iterator for FrameRows {
    type Item = Result<Frame, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let next = self.read_next();
        self.ended = !matches!(next, Ok(Some(_)));
        next.transpose()
    }
}

/// The tables of one camera, read in step.
struct CameraRows {
    camera: u8,
    images: Table,
    /// The folder of the images, where there are any.
    image_folder: Option<PathBuf>,
    /// Time stamp of the next image; `None` after the last.
    image_ns: Option<i64>,
    tracks: Option<ImageRows>,
    seen_ids: HashSet<u64>,
    features: Option<ImageRows>,
    /// Bytes of a descriptor, from the first row on.
    width: Option<usize>,
}

impl CameraRows {
    fn open(folder: &Path, camera: u8, stamps: &TableStamps) -> Result<Self, SequenceError> {
        let path = folder.join("data.csv");
        let image_folder = folder.join("data");
        let mut rows = Self {
            camera,
            images: Table::open_in_order(
                &path,
                "it lists the time stamps of this camera's images",
                &stamps.order,
            )?,
            image_folder: image_folder.is_dir().then_some(image_folder),
            image_ns: None,
            tracks: ImageRows::open_if_there(&folder.join("tracks.csv"), stamps)?,
            seen_ids: HashSet::new(),
            features: ImageRows::open_if_there(&folder.join("features.csv"), stamps)?,
            width: None,
        };
        rows.advance()?;
        if rows.image_ns.is_none() {
            return Err(SequenceError::empty(&path, "list the images as `timestamp [ns],filename`"));
        }
        Ok(rows)
    }

    /// Reads the row of the next image.
    fn advance(&mut self) -> Result<(), SequenceError> {
        let Some(row) = self.images.next_row()? else {
            self.image_ns = None;
            return Ok(());
        };
        let stamp_ns = row.stamp()?;
        check_order(&row, self.image_ns, stamp_ns)?;
        self.image_ns = Some(stamp_ns);
        Ok(())
    }

    /// Leaves out images without a partner, and what belongs to them, up to an image.
    fn skip_to(&mut self, image_ns: i64) -> Result<(), SequenceError> {
        while let Some(lone_ns) = self.image_ns.filter(|lone_ns| *lone_ns < image_ns) {
            self.drop_rows(lone_ns)?;
            self.advance()?;
        }
        Ok(())
    }

    /// Leaves out what belongs to an image.
    fn drop_rows(&mut self, image_ns: i64) -> Result<(), SequenceError> {
        [&mut self.tracks, &mut self.features]
            .into_iter()
            .flatten()
            .try_for_each(|rows| rows.drop_of(image_ns))
    }

    /// Reads all that belongs to the next image into its frame, and advances.
    fn read_into(&mut self, frame: &mut Frame) -> Result<(), SequenceError> {
        // The images of a frame have stamps of their own.
        let Some(image_ns) = self.image_ns else { return Ok(()) };
        if let Some(folder) = &self.image_folder {
            let file = image_file(&self.images.row(), folder)?;
            frame.images.insert(usize::from(self.camera), ImageData::File(file));
        }
        if let Some(tracks) = &mut self.tracks {
            self.seen_ids.clear();
            tracks.take(image_ns, |row| {
                let track = track_of(row, self.camera)?;
                if !self.seen_ids.insert(track.feature_id) {
                    return Err(row.wrong(format!(
                        "feature {} appears twice in this image: a track has one pixel an image, delete one",
                        track.feature_id
                    )));
                }
                frame.tracks.push(track);
                Ok(())
            })?;
        }
        if let Some(features) = &mut self.features {
            let mut set = None;
            features.take(image_ns, |row| add_feature(row, &mut set, &mut self.width))?;
            frame.features.extend(set.map(|set| (usize::from(self.camera), set)));
        }
        self.advance()
    }

    /// Checks that there are no tracks and features after the last image.
    fn expect_end(&self) -> Result<(), SequenceError> {
        [&self.tracks, &self.features].into_iter().flatten().try_for_each(ImageRows::expect_end)
    }
}

/// A table with several rows an image, in the order of the images.
struct ImageRows {
    table: Table,
    /// Time stamp of the row that was read last and not taken yet.
    pending_ns: Option<i64>,
    /// Time stamp of the row before it.
    before_ns: Option<i64>,
    /// Stamps of images that are left out.
    left_out: Arc<HashSet<i64>>,
}

impl ImageRows {
    /// Opens the table, sorted where the list of the images was.
    fn open_if_there(path: &Path, images: &TableStamps) -> Result<Option<Self>, SequenceError> {
        if !path.exists() {
            return Ok(None);
        }
        let order =
            if images.order.sorted.is_some() { RowOrder::by_stamp(path)? } else { RowOrder::default() };
        let table = Table::open_in_order(path, "it holds what was seen in images", &order)?;
        let left_out = Arc::clone(&images.left_out);
        let mut rows = Self { table, pending_ns: None, before_ns: None, left_out };
        rows.advance()?;
        Ok(Some(rows))
    }

    fn advance(&mut self) -> Result<(), SequenceError> {
        self.before_ns = self.pending_ns;
        loop {
            self.pending_ns = match self.table.next_row()? {
                Some(row) => {
                    row.require(4)?;
                    Some(row.stamp()?)
                }
                None => None,
            };
            if !self.pending_ns.is_some_and(|stamp_ns| self.left_out.contains(&stamp_ns)) {
                return Ok(());
            }
        }
    }

    /// Leaves out the rows of an image, if they come next.
    fn drop_of(&mut self, image_ns: i64) -> Result<(), SequenceError> {
        while self.pending_ns == Some(image_ns) {
            self.advance()?;
        }
        Ok(())
    }

    /// Calls `each` with the rows of an image, which must be the next one.
    fn take(
        &mut self,
        image_ns: i64,
        mut each: impl FnMut(&Row<'_>) -> Result<(), SequenceError>,
    ) -> Result<(), SequenceError> {
        while self.pending_ns.is_some_and(|pending_ns| pending_ns <= image_ns) {
            if self.pending_ns != Some(image_ns) {
                return self.expect_end();
            }
            each(&self.table.row())?;
            self.advance()?;
        }
        Ok(())
    }

    /// Checks that no row is left: its image is not in the list.
    fn expect_end(&self) -> Result<(), SequenceError> {
        let Some(stamp_ns) = self.pending_ns else { return Ok(()) };
        let row = self.table.row();
        Err(row.wrong(if self.before_ns.is_some_and(|before_ns| stamp_ns < before_ns) {
            format!("time stamp {stamp_ns} goes back in time: sort the file by time")
        } else {
            format!(
                "time stamp {stamp_ns} is not in this camera's data.csv: list the image there, or delete the row"
            )
        }))
    }
}

/// The image file of a row of `data.csv`, which must exist.
fn image_file(row: &Row<'_>, folder: &Path) -> Result<PathBuf, SequenceError> {
    let name = String::from_utf8_lossy(row.cell(1)?).into_owned();
    let is_inside =
        Path::new(&name).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if !is_inside {
        return Err(row.wrong(format!("the image {name} is outside of {}: lay it there", folder.display())));
    }
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

/// Parses a row of `tracks.csv`.
fn track_of(row: &Row<'_>, camera: u8) -> Result<TrackObservation, SequenceError> {
    let pixel = Vector2::new(row.finite(2)?, row.finite(3)?);
    Ok(TrackObservation { camera, feature_id: row.parse(1)?, pixel })
}

/// Adds a row of `features.csv` to the features of its image. `width`: bytes of the descriptors before.
fn add_feature(
    row: &Row<'_>,
    features: &mut Option<FeatureSet>,
    width: &mut Option<usize>,
) -> Result<(), SequenceError> {
    let pixel = [row.finite(1)? as f32, row.finite(2)? as f32];
    let hex = row.cell(3)?;
    let set = features.get_or_insert_with(|| empty_features((hex.len() / 2) as u16));
    let bytes_before = set.descriptors.bytes.len();
    decode_hex(row, hex, &mut set.descriptors.bytes)?;
    let bytes = set.descriptors.bytes.len() - bytes_before;
    let before = *width.get_or_insert(bytes);
    if bytes != before || bytes > usize::from(u16::MAX) {
        return Err(row.wrong(format!(
            "the descriptor has {bytes} bytes, those before have {before}: the row is cut off, or the file mixes kinds"
        )));
    }
    set.pixels.push(pixel);
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
