//! Messages of a recording on their way to the disk: a queue, and the thread that writes.

use bags::{Bag, BagError, MessageType, OfferedQos};
use ros_messages::{RosMessage, encode};
use sensors::ImageData;
use sensors::ros::image_message;
use sensors::ros_bag::{RosBagWriter, message_type};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Messages that may wait for the disk where the run waits for it.
const QUEUE: usize = 256;
/// Messages that may wait for the disk in real time, where further ones are dropped: the readings of half a minute at 1 kHz, which
/// come at once with the first image.
const REALTIME_QUEUE: usize = 1 << 15;
/// Images that may wait for the disk in real time, which take the memory: three seconds of a stereo pair at 20 Hz.
const REALTIME_IMAGES: usize = 120;
/// What was written is readable after so long, also when the robot is switched off.
const FLUSH: Duration = Duration::from_secs(1);

/// The queue; when it is dropped, what waits is written, and the file completed.
#[derive(Debug)]
pub(super) struct RecordingQueue {
    path: PathBuf,
    sender: Option<SyncSender<Item>>,
    thread: Option<JoinHandle<()>>,
    /// Whether messages are dropped where the disk is too slow.
    realtime: bool,
    /// Images that wait.
    images: Arc<AtomicUsize>,
    dropped: u64,
}

/// A message on its way to the disk.
struct Item {
    stamp_ns: i64,
    /// What the topic is offered with; `None` for what a topic of its name usually has.
    qos: Option<OfferedQos>,
    content: Content,
}

impl Item {
    fn is_image(&self) -> bool {
        matches!(self.content, Content::Image { .. })
    }
}

enum Content {
    Message {
        topic: String,
        /// Makes the type, with its definition: by the thread, once a topic.
        of: fn() -> MessageType,
        bytes: Vec<u8>,
    },
    /// Read and encoded by the thread.
    Image { camera: usize, frame: String, image: ImageData },
}

impl RecordingQueue {
    /// Starts the thread. A failing disk ends the recording, not the run.
    pub(super) fn start(path: PathBuf, writer: RosBagWriter, realtime: bool) -> Result<Self, BagError> {
        let (sender, items) = sync_channel(if realtime { REALTIME_QUEUE } else { QUEUE });
        let images = Arc::new(AtomicUsize::new(0));
        let (file, waiting) = (path.clone(), Arc::clone(&images));
        let thread = std::thread::Builder::new()
            .name("recording".into())
            .spawn(move || {
                if let Err(error) = write_all(writer, &items, &waiting) {
                    tracing::warn!(%error, "the recording {} ends here; the run continues", file.display());
                    remove_unless_readable(&file);
                }
            })
            .map_err(|source| BagError::Io { path: path.clone(), source })?;
        Ok(Self { path, sender: Some(sender), thread: Some(thread), realtime, images, dropped: 0 })
    }

    /// Appends a message to a topic.
    pub(super) fn message<M: RosMessage>(
        &mut self,
        topic: &str,
        stamp_ns: i64,
        message: &M,
        qos: Option<OfferedQos>,
    ) {
        let Ok(bytes) = encode(message) else { return };
        let content = Content::Message { topic: topic.to_owned(), of: message_type::<M>, bytes };
        self.send(Item { stamp_ns, qos, content });
    }

    /// Appends an image of a camera.
    pub(super) fn image(
        &mut self,
        (camera, frame): (usize, &str),
        stamp_ns: i64,
        image: ImageData,
        qos: Option<OfferedQos>,
    ) {
        if self.realtime && self.images.load(Ordering::Relaxed) >= REALTIME_IMAGES {
            self.dropped += 1;
            return;
        }
        self.images.fetch_add(1, Ordering::Relaxed);
        let content = Content::Image { camera, frame: frame.to_owned(), image };
        self.send(Item { stamp_ns, qos, content });
    }

    /// Sends to the thread, which is gone where writing failed: that was said.
    fn send(&mut self, item: Item) {
        let Some(sender) = &self.sender else { return };
        if !self.realtime {
            let _ = sender.send(item);
        } else if let Err(TrySendError::Full(item)) = sender.try_send(item) {
            self.dropped += 1;
            if item.is_image() {
                self.images.fetch_sub(1, Ordering::Relaxed);
            }
        }
    }
}

impl Drop for RecordingQueue {
    fn drop(&mut self) {
        self.sender = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the recording panicked");
        }
        if self.dropped > 0 {
            let path = self.path.display();
            tracing::warn!("{} messages are missing in {path}: the disk is too slow", self.dropped);
        }
    }
}

fn write_all(mut writer: RosBagWriter, items: &Receiver<Item>, images: &AtomicUsize) -> Result<(), BagError> {
    let mut flushed = Instant::now();
    loop {
        match items.recv_timeout(FLUSH) {
            Ok(item) => {
                if item.is_image() {
                    images.fetch_sub(1, Ordering::Relaxed);
                }
                write(&mut writer, item)?;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writer.finish(),
        }
        if flushed.elapsed() >= FLUSH {
            writer.flush()?;
            flushed = Instant::now();
        }
    }
}

/// Removes a recording that failed before any message was on the disk, as on a full one.
fn remove_unless_readable(path: &Path) {
    let has_messages = |bag: &Bag| bag.topics().iter().any(|topic| !topic.messages.is_empty());
    if !path.is_file() || Bag::open(path).as_ref().is_ok_and(has_messages) {
        return;
    }
    match std::fs::remove_file(path) {
        Ok(()) => tracing::warn!("{} was removed: nothing in it could be read", path.display()),
        Err(error) => tracing::warn!(%error, "nothing in {} can be read", path.display()),
    }
}

fn write(writer: &mut RosBagWriter, item: Item) -> Result<(), BagError> {
    let Item { stamp_ns, qos, content } = item;
    let offered = |writer: &mut RosBagWriter, topic: &str| {
        if let Some(qos) = qos {
            writer.offer(topic, qos);
        }
    };
    match content {
        Content::Message { topic, of, bytes } => {
            offered(writer, &topic);
            writer.write(&topic, of, stamp_ns, &bytes)
        }
        Content::Image { camera, frame, image } => {
            // One that cannot be read is left out.
            let message = image_message(&image, stamp_ns, &frame)
                .inspect_err(|error| tracing::warn!(%error, "an image is not recorded"));
            let Ok(Some(message)) = message else { return Ok(()) };
            let Ok(bytes) = message.encode() else { return Ok(()) };
            let topic = message.topic(camera);
            offered(writer, &topic);
            writer.write(&topic, || message.message_type(), stamp_ns, &bytes)
        }
    }
}
