//! Queries of a map server to the cells of a map, its own and those of other servers.

use crate::error::ClientError;
use crate::request::{Request, Retry, SingleReply, Traffic};
use protocol::keys::{self, NameError};
use protocol::{CellLocalizeReply, CellMatchReply, KeyframeId, KeyframeReply, Message};
use std::time::Instant;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::sample::Locality;

/// A query of a robot that is passed on to cells as it came.
#[derive(Clone, Debug)]
pub struct ForwardedQuery {
    /// Its payload.
    pub payload: ZBytes,
    /// The encoding of the payload.
    pub encoding: Encoding,
    /// Who asked: servers are fair to robots, whichever server passes their queries on.
    pub client: String,
}

/// The answer of a cell to a kind of query.
pub trait CellReply: Message {
    /// The key of such queries.
    ///
    /// # Errors
    /// [`NameError`] if the name cannot be part of a key.
    fn key(map: &str, cell: u32) -> Result<String, NameError>;
}

impl CellReply for CellMatchReply {
    fn key(map: &str, cell: u32) -> Result<String, NameError> {
        keys::cell_match(map, cell)
    }
}

impl CellReply for CellLocalizeReply {
    fn key(map: &str, cell: u32) -> Result<String, NameError> {
        keys::cell_localize(map, cell)
    }
}

/// Where a cell is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellPlacement {
    /// In the session of the asking server.
    Here,
    /// At another server.
    Elsewhere,
}

/// Queries to the cells of one map over an open Zenoh session.
///
/// Each is repeated until its deadline as described in the [crate documentation](crate#retries): where a server of a cell stops,
/// another one that has the cell answers.
#[derive(Clone, Debug)]
pub struct CellClient {
    session: zenoh::Session,
    map: String,
}

impl CellClient {
    /// A client for the map that is served as `map`.
    ///
    /// # Errors
    /// [`NameError`] for a name that cannot be part of a key.
    pub fn new(session: zenoh::Session, map: &str) -> Result<Self, NameError> {
        keys::validate_name(map)?;
        Ok(Self { session, map: map.to_owned() })
    }

    /// Passes a query on to a cell.
    ///
    /// # Errors
    /// [`ClientError`]; of the last attempt, if several were made.
    pub async fn forward<R: CellReply>(
        &self,
        cell: u32,
        placement: CellPlacement,
        query: &ForwardedQuery,
        deadline: Instant,
    ) -> Result<R, ClientError> {
        let request = self.request(R::key(&self.map, cell), placement, &query.client, deadline)?;
        let request = request.with_encoded(query.payload.clone(), query.encoding.clone());
        request.send::<SingleReply<R>>(Retry::Transient, &mut Traffic::default()).await
    }

    /// Asks a cell for one of its keyframes.
    ///
    /// # Errors
    /// [`ClientError`]; of the last attempt, if several were made.
    pub async fn keyframe(
        &self,
        cell: u32,
        placement: CellPlacement,
        id: KeyframeId,
        client: &str,
        deadline: Instant,
    ) -> Result<KeyframeReply, ClientError> {
        let key = keys::cell_keyframe(&self.map, cell, Some(id));
        let request = self.request(key, placement, client, deadline)?;
        request.send::<SingleReply<KeyframeReply>>(Retry::Transient, &mut Traffic::default()).await
    }

    fn request(
        &self,
        key: Result<String, NameError>,
        placement: CellPlacement,
        client: &str,
        deadline: Instant,
    ) -> Result<Request, ClientError> {
        let key = key.map_err(|error| ClientError::Send { problem: error.to_string() })?;
        let destination = match placement {
            CellPlacement::Here => Locality::SessionLocal,
            CellPlacement::Elsewhere => Locality::Remote,
        };
        Ok(Request::new(&self.session, key, deadline).for_client(client, destination))
    }
}
