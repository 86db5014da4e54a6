//! All images of a recording at once, on all processors.

use sensors::{ImageData, Sequence, writer};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use vision::ImageError;

/// Why the images of a recording were not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteImagesError {
    /// A folder cannot be created.
    #[error("cannot create the folder {}: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// An image cannot be read or written.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// Reads all images of a recording and keeps them in memory: 0.36 MB each at 752 x 480 pixels.
///
/// # Arguments
/// * `progress`: called with the number of images that are ready, and of all.
///
/// # Errors
/// [`ImageError`]: an image cannot be read; simulated ones always can.
pub fn render_all(sequence: &mut Sequence, progress: impl FnMut(usize, usize)) -> Result<(), ImageError> {
    let places = places(sequence);
    let read = |(frame, camera): Place| {
        let image = &sequence.frames[frame].images[&camera];
        image.read().map(|image| ImageData::from(image.into_owned()))
    };
    let images = on_all_processors(&places, read, progress)?;
    for ((frame, camera), image) in images {
        sequence.frames[frame].images.insert(camera, image);
    }
    Ok(())
}

/// Writes all images of a recording as files of the EuRoC layout, below `root`, beside what [`writer::write`] writes.
///
/// # Arguments
/// * `progress`: called with the number of images that are written, and of all.
///
/// # Errors
/// [`WriteImagesError`] with the file or folder that cannot be written.
pub fn write_images(
    sequence: &Sequence,
    root: &Path,
    progress: impl FnMut(usize, usize),
) -> Result<(), WriteImagesError> {
    let folder = |camera: usize| root.join(format!("mav0/cam{camera}/data"));
    for path in (0..sequence.cameras.len()).map(folder) {
        std::fs::create_dir_all(&path).map_err(|source| WriteImagesError::Folder { path, source })?;
    }
    let write = |(frame, camera): Place| -> Result<(), WriteImagesError> {
        let frame = &sequence.frames[frame];
        let image = &frame.images[&camera];
        image.read()?.write(&folder(camera).join(writer::image_name(frame.stamp_ns, Some(image))))?;
        Ok(())
    };
    on_all_processors(&places(sequence), write, progress).map(drop)
}

/// Frame and camera of an image.
type Place = (usize, usize);

/// Those of every image.
fn places(sequence: &Sequence) -> Vec<Place> {
    let frames = sequence.frames.iter().enumerate();
    frames.flat_map(|(index, frame)| frame.images.keys().map(move |camera| (index, *camera))).collect()
}

/// Does something for each image; the first error ends it.
fn on_all_processors<T: Send, E: Send>(
    places: &[Place],
    work: impl Fn(Place) -> Result<T, E> + Sync,
    mut progress: impl FnMut(usize, usize),
) -> Result<Vec<(Place, T)>, E> {
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(places.len().max(1));
    let (outbox, results) = channel();
    let (work, next) = (&work, &next);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let outbox = outbox.clone();
            scope.spawn(move || {
                while let Some(place) = places.get(next.fetch_add(1, Ordering::Relaxed)) {
                    // Nobody receives after an error.
                    if outbox.send((*place, work(*place))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(outbox);
        let mut done = Vec::with_capacity(places.len());
        for (place, result) in results {
            done.push((place, result?));
            progress(done.len(), places.len());
        }
        Ok(done)
    })
}
