//! Handing session files in to a map server.

use crate::error::ClientError;
use crate::map_client::MapClient;
use crate::request::{Request, Retry, SingleReply, Traffic};
use protocol::{MAX_SESSION_PART_BYTES, SessionPart, SessionPartReply, keys};
use std::time::{Duration, Instant};

/// How often a file that was damaged on its way is sent again.
const MOST_ATTEMPTS: usize = 3;
/// Bytes of a part beside those of the file: envelope, key and Zenoh's own.
const BYTES_BESIDE: f64 = 300.0;
/// A part takes so long at most at the rate that is wanted, so that the link is free in between (s).
const SECONDS_A_PART: f64 = 1.0;

/// A session file to be handed in.
#[derive(Clone, Copy, Debug)]
pub struct SessionUpload<'a> {
    /// The robot that recorded it.
    pub robot: &'a str,
    /// SHA-256 of the file.
    pub digest: [u8; 32],
    /// The file.
    pub bytes: &'a [u8],
    /// Bytes a second that may be sent, those of headers included.
    pub bytes_per_second: f64,
    /// How long a part may take, repetitions included, before it is given up.
    pub patience: Duration,
}

impl MapClient {
    /// Hands a session file in: from where the server has it, until it is complete and on the disk of the server.
    ///
    /// Handing in the same file again goes on where the last attempt ended, and does nothing where it was complete.
    ///
    /// # Arguments
    /// * `progress`: called with the bytes that the server has.
    ///
    /// # Errors
    /// [`ClientError`]: no server takes sessions of this map, the link is lost for longer than the patience, or the server refuses
    /// the file and says why.
    pub async fn hand_in(
        &self,
        upload: &SessionUpload<'_>,
        mut progress: impl FnMut(u64),
    ) -> Result<(), ClientError> {
        let rate = upload.bytes_per_second.max(1.0);
        let length =
            (rate * SECONDS_A_PART - BYTES_BESIDE).clamp(256.0, MAX_SESSION_PART_BYTES as f64) as usize;
        let mut reply = self.send_part(upload, 0, 0).await?;
        let mut attempts = 1;
        while !reply.is_complete {
            progress(reply.received_bytes);
            let begin = tokio::time::Instant::now();
            let before = reply.received_bytes;
            reply = self.send_part(upload, before, length).await?;
            // Damaged files are begun again.
            if reply.received_bytes <= before && !reply.is_complete {
                attempts += 1;
                if attempts > MOST_ATTEMPTS {
                    return Err(ClientError::Damaged { attempts: MOST_ATTEMPTS });
                }
            }
            let sent = (upload.bytes.len() as u64 - before).min(length as u64) as f64 + BYTES_BESIDE;
            if !reply.is_complete {
                tokio::time::sleep_until(begin + Duration::from_secs_f64(sent / rate)).await;
            }
        }
        progress(upload.bytes.len() as u64);
        Ok(())
    }

    async fn send_part(
        &self,
        upload: &SessionUpload<'_>,
        offset: u64,
        length: usize,
    ) -> Result<SessionPartReply, ClientError> {
        let from = usize::try_from(offset).unwrap_or(usize::MAX).min(upload.bytes.len());
        let to = from.saturating_add(length).min(upload.bytes.len());
        let part = SessionPart {
            total_bytes: upload.bytes.len() as u64,
            digest: upload.digest,
            offset: from as u64,
            bytes: upload.bytes[from..to].to_vec(),
        };
        let key = keys::map_sessions(self.map(), Some(upload.robot));
        let key = key.map_err(|error| ClientError::Send { problem: error.to_string() })?;
        let request =
            Request::new(self.session(), key, Instant::now() + upload.patience).with_payload(&part)?;
        request.send::<SingleReply<SessionPartReply>>(Retry::Transient, &mut Traffic::default()).await
    }
}
