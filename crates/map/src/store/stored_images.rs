//! The images of a stored map, read one at a time.

use std::path::Path;

use protocol::KeyframeId;

use super::error::StoreError;
use super::reading::read_present;
use super::version_file::VersionFile;
use crate::added::KeptImage;
use crate::file::record::{Element as _, Table, decode};
use crate::file::segment::{OF_IMAGES, SegmentName};

/// The images of a stored map: which keyframes have one is in memory, the images stay on the disk.
///
/// A map that is replaced meanwhile is read to its end as it was.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, store};
/// use protocol::DescriptorKind;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hall.db");
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// store::save_map(&path, &contents, false)?;
/// let mut images = store::StoredImages::open(&path)?;
/// assert_eq!((images.len(), images.bytes()), (0, 0));
/// assert_eq!(images.read(7)?, None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct StoredImages {
    file: VersionFile,
    version: u64,
    segments: Vec<ImageSegment>,
}

/// One segment of images.
struct ImageSegment {
    /// Where it begins in the file.
    at: u64,
    name: SegmentName,
    /// The keyframes of its images, ascending.
    keyframes: Vec<KeyframeId>,
}

impl StoredImages {
    /// Opens the images of the map in a folder. Every byte of them is verified.
    ///
    /// # Errors
    /// As of [`load_map`](super::load_map).
    pub fn open(path: impl AsRef<Path>) -> Result<StoredImages, StoreError> {
        let path = path.as_ref();
        read_present(path, |manifest| {
            let mut file = VersionFile::open(path, manifest)?;
            let (mut at, names) = file.images();
            let mut segments: Vec<ImageSegment> = Vec::with_capacity(names.len());
            for name in names {
                let mut keyframes = Vec::new();
                let piece = (at, std::slice::from_ref(&name));
                file.visit_records(piece, OF_IMAGES, Table::Images, true, |keyframe, _| {
                    keyframes.push(keyframe);
                    Ok(())
                })?;
                let bytes = name.bytes;
                segments.push(ImageSegment { at, name, keyframes });
                at += bytes;
            }
            Ok(StoredImages { file, version: manifest.map.version, segments })
        })
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.segments.iter().map(|segment| segment.keyframes.len()).sum()
    }

    /// Whether the map keeps none.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// Bytes of all images on the disk.
    pub fn bytes(&self) -> u64 {
        self.segments.iter().map(|segment| segment.name.bytes).sum()
    }

    /// The version of the map whose images they are.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// The keyframes that have one, ascending.
    pub fn keyframes(&self) -> impl Iterator<Item = KeyframeId> {
        self.segments.iter().flat_map(|segment| &segment.keyframes).copied()
    }

    /// The image of a keyframe; `None` where none is kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Read`] where the file fails now.
    pub fn read(&mut self, keyframe: KeyframeId) -> Result<Option<KeptImage>, StoreError> {
        let has = |segment: &&ImageSegment| segment.keyframes.binary_search(&keyframe).is_ok();
        let Some(segment) = self.segments.iter().find(has) else { return Ok(None) };
        let mut found = None;
        let piece = (segment.at, std::slice::from_ref(&segment.name));
        self.file.visit_records(piece, OF_IMAGES, Table::Images, true, |id, payload| {
            if id == keyframe {
                found = Some(KeptImage::from_record([id], decode(payload)?)?);
            }
            Ok(())
        })?;
        Ok(found)
    }
}
