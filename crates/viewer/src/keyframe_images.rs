//! The images that a map keeps of its keyframes.

use crate::api::{UNKNOWN_MAP, error};
use crate::server::Viewer;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use map::store::StoredImages;
use protocol::KeyframeId;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Images of the keyframes of a map.
pub trait KeyframeImages: Send + Sync {
    /// How many there are.
    fn count(&self) -> usize;

    /// The image of a keyframe, a JPEG file; `None` where none is kept. It is called on a thread that may block.
    ///
    /// # Errors
    /// Why it cannot be read, in words.
    fn jpeg(&self, keyframe: KeyframeId) -> Result<Option<Vec<u8>>, String>;
}

/// In memory.
impl KeyframeImages for BTreeMap<KeyframeId, Vec<u8>> {
    fn count(&self) -> usize {
        self.len()
    }

    fn jpeg(&self, keyframe: KeyframeId) -> Result<Option<Vec<u8>>, String> {
        Ok(self.get(&keyframe).cloned())
    }
}

/// In the database of the map, read one at a time.
impl KeyframeImages for Mutex<StoredImages> {
    fn count(&self) -> usize {
        self.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    fn jpeg(&self, keyframe: KeyframeId) -> Result<Option<Vec<u8>>, String> {
        let read = self.lock().unwrap_or_else(PoisonError::into_inner).read(keyframe);
        read.map(|found| found.map(|image| image.jpeg)).map_err(|error| error.to_string())
    }
}

/// `GET /api/maps/{map}/keyframes/{keyframe}/image`.
pub(crate) async fn image(
    State(viewer): State<Arc<Viewer>>,
    Path((name, keyframe)): Path<(String, String)>,
) -> Response {
    let Ok(keyframe) = keyframe.parse::<KeyframeId>() else {
        return error(StatusCode::BAD_REQUEST, "a keyframe is named by its id, a number");
    };
    if viewer.map(&name).is_none() {
        return error(StatusCode::NOT_FOUND, UNKNOWN_MAP);
    }
    let Some(images) = viewer.keyframe_images(&name) else {
        let what = "no images of this map are kept, or not here; driftless build-map --keep-images keeps them in a database";
        return error(StatusCode::NOT_FOUND, what);
    };
    // Each waits for the disk.
    let Ok(turn) = Arc::clone(&viewer.disk_turn).acquire_owned().await else {
        return error(StatusCode::SERVICE_UNAVAILABLE, "the server stops");
    };
    let read = move || {
        let found = images.jpeg(keyframe);
        // The next one may be read, also where nobody waits for this answer any more.
        drop(turn);
        found
    };
    let reading = tokio::task::spawn_blocking(read).await;
    match reading.map_err(|error| error.to_string()).flatten() {
        Ok(Some(jpeg)) => match viewer.outbox.reserve(jpeg.len()).await.and_then(|room| room.hold(jpeg)) {
            Some(bytes) => ([(header::CONTENT_TYPE, "image/jpeg")], bytes).into_response(),
            None => error(
                StatusCode::SERVICE_UNAVAILABLE,
                "too many images are being read: try again in a moment",
            ),
        },
        Ok(None) => error(StatusCode::NOT_FOUND, "no image of this keyframe is kept"),
        Err(what) => error(StatusCode::INTERNAL_SERVER_ERROR, &what),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewed_map::ViewedMap;
    use map::{MapContents, MapMetadata};
    use protocol::DescriptorKind;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    /// A disk that counts how many images are read at the same time.
    #[derive(Default)]
    struct Slow {
        reading: AtomicUsize,
        most: AtomicUsize,
    }

    impl KeyframeImages for Slow {
        fn count(&self) -> usize {
            1
        }

        fn jpeg(&self, _: KeyframeId) -> Result<Option<Vec<u8>>, String> {
            let reading = self.reading.fetch_add(1, Ordering::SeqCst) + 1;
            self.most.fetch_max(reading, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(50));
            self.reading.fetch_sub(1, Ordering::SeqCst);
            Ok(Some(vec![0xff]))
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn images_are_read_one_at_a_time_also_where_readers_leave() {
        let viewer = Viewer::new();
        let contents = MapContents::empty(MapMetadata::new("hall", "test", DescriptorKind::Binary, 32));
        viewer.set_map(ViewedMap::of_contents("hall", &contents));
        let disk = Arc::new(Slow::default());
        viewer.set_keyframe_images("hall", disk.clone());
        let ask = || image(State(Arc::clone(&viewer)), Path(("hall".to_owned(), "1".to_owned())));
        let leaving = tokio::spawn(ask());
        let begun = async {
            while disk.most.load(Ordering::SeqCst) == 0 {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(Duration::from_mins(1), begun).await.unwrap();
        leaving.abort();
        assert_eq!(ask().await.status(), StatusCode::OK);
        assert_eq!(disk.most.load(Ordering::SeqCst), 1);
    }
}
