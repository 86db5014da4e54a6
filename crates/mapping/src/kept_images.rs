//! Keeping the images of keyframes in a map, so that features of further kinds can be computed in them.

use std::collections::HashMap;

use map::{KeptImage, MapContents};
use sensors::{ImageData, Sequence};

use super::camera::Rig;
use super::error::BuildError;
use super::session::last_keyframe;

/// What was kept of a recording.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct KeptImages {
    /// Number of images.
    pub images: usize,
    /// Bytes of all of them.
    pub bytes: usize,
    /// Images that could not be read, with the reason.
    pub unreadable: Vec<String>,
}

/// Keeps the image of each keyframe that a recording has given to a map, grey, as JPEG. Of a stereo pair it is that of the first
/// camera, of whose pixels the map's features are.
///
/// # Arguments
/// * `contents`: the map of the recording, or the one that was extended by it.
/// * `stored`: the map that was extended, if one was; its images stay.
/// * `cameras`: how many cameras of the recording were used.
/// * `quality`: of JPEG, 1 to 100.
///
/// # Errors
/// [`BuildError::NoImages`] where the recording has none of any keyframe, [`BuildError::Encoding`].
pub fn keep_images(
    contents: &mut MapContents,
    stored: Option<&MapContents>,
    sequence: &Sequence,
    cameras: usize,
    quality: u8,
) -> Result<KeptImages, BuildError> {
    let rig = Rig::new(&sequence.cameras, cameras);
    let after = stored.map_or(0, last_keyframe);
    let images: HashMap<(i64, usize), &ImageData> = sequence
        .frames
        .iter()
        .flat_map(|frame| frame.images.iter().map(|(&camera, image)| ((frame.stamp_ns, camera), image)))
        .collect();
    let mut kept = KeptImages::default();
    for keyframe in contents.keyframes.iter().filter(|keyframe| keyframe.id > after) {
        let camera = rig.groups[rig.group_of_keyframe(keyframe.id - after)].first;
        let Some(image) = images.get(&(keyframe.stamp_ns, camera)) else { continue };
        let pixels = match image.read() {
            Ok(pixels) => pixels,
            Err(error) => {
                kept.unreadable.push(error.to_string());
                continue;
            }
        };
        let jpeg = pixels
            .to_jpeg(quality)
            .map_err(|source| BuildError::Encoding { image: image.to_string(), source })?;
        kept.images += 1;
        kept.bytes += jpeg.len();
        contents.images.push(KeptImage { keyframe: keyframe.id, jpeg });
    }
    if kept.images == 0 {
        return Err(BuildError::NoImages { sequence: sequence.root.display().to_string() });
    }
    contents.images.sort_by_key(|image| image.keyframe);
    Ok(kept)
}
