//! TLS to a broker: which authorities its certificate must be of, and the certificate of the bridge.

use rustls::pki_types::pem::{self, PemObject as _};
use rustls::pki_types::{CertificateDer, InvalidDnsNameError, PrivateKeyDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// Why a connection by TLS cannot be prepared.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BrokerTlsError {
    /// A text of certificates that cannot be read.
    #[error("the certificates of {of} are not in PEM: {source}")]
    NoPem {
        /// Whose they are.
        of: CertificateOf,
        /// What is wrong.
        source: pem::Error,
    },
    /// A text without a certificate.
    #[error("there is no certificate of {0} in the file: it must hold -----BEGIN CERTIFICATE-----")]
    NoCertificate(CertificateOf),
    /// A certificate that cannot be an authority's.
    #[error("a certificate of the authorities cannot be used: {0}")]
    Authority(rustls::Error),
    /// This system has no authorities.
    #[error(
        "this system has no certificates of authorities ({reason}): those of the broker are needed, in PEM"
    )]
    NoSystemAuthorities {
        /// What went wrong, if anything did.
        reason: String,
    },
    /// A text without a private key, or with one that is encrypted.
    #[error("the key cannot be read: {0}; it must be an unencrypted private key in PEM")]
    Key(pem::Error),
    /// A key of another kind, or of another certificate.
    #[error("certificate and key cannot be used: {0}")]
    Identity(rustls::Error),
    /// A host that no certificate can be of.
    #[error("{host:?} cannot be the name in a certificate: {source}")]
    Host {
        /// Of the address.
        host: String,
        /// What is wrong.
        source: InvalidDnsNameError,
    },
    /// The protocol versions are not supported.
    #[error("TLS cannot be used: {0}")]
    Versions(rustls::Error),
}

/// Whose certificates are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CertificateOf {
    /// The broker's authorities.
    Authorities,
    /// The bridge.
    Bridge,
}

impl fmt::Display for CertificateOf {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Authorities => "the authorities",
            Self::Bridge => "the bridge",
        })
    }
}

/// Certificate and key of the bridge, for brokers that ask for one.
#[derive(Clone, PartialEq, Eq)]
pub struct ClientIdentity {
    /// Its certificate, then those between it and the authority, in PEM.
    pub certificates_pem: Vec<u8>,
    /// Its private key, in PEM: PKCS #8, PKCS #1 or SEC 1, not encrypted.
    pub key_pem: Vec<u8>,
}

impl fmt::Debug for ClientIdentity {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ClientIdentity").finish_non_exhaustive()
    }
}

/// How a broker is reached by TLS 1.2 or 1.3. Its certificate must be valid for the host of its address.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BrokerTls {
    /// Certificates of the authorities that its certificate must be of, in PEM; `None` for those of this system.
    pub authorities_pem: Option<Vec<u8>>,
    /// Who the bridge is; `None` for brokers that do not ask.
    pub identity: Option<ClientIdentity>,
}

impl BrokerTls {
    /// The configuration of connections.
    ///
    /// # Errors
    /// [`BrokerTlsError`] names what cannot be used.
    pub(crate) fn client_config(&self) -> Result<Arc<ClientConfig>, BrokerTlsError> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(BrokerTlsError::Versions)?
            .with_root_certificates(self.authorities()?);
        let config = match &self.identity {
            None => builder.with_no_client_auth(),
            Some(identity) => {
                let chain = certificates(&identity.certificates_pem, CertificateOf::Bridge)?;
                let key = PrivateKeyDer::from_pem_slice(&identity.key_pem).map_err(BrokerTlsError::Key)?;
                builder.with_client_auth_cert(chain, key).map_err(BrokerTlsError::Identity)?
            }
        };
        Ok(Arc::new(config))
    }

    /// The name for which the certificate of a host must be valid.
    pub(crate) fn name_of(host: &str) -> Result<ServerName<'static>, BrokerTlsError> {
        let name = ServerName::try_from(host.to_owned());
        name.map_err(|source| BrokerTlsError::Host { host: host.to_owned(), source })
    }

    fn authorities(&self) -> Result<RootCertStore, BrokerTlsError> {
        let mut authorities = RootCertStore::empty();
        if let Some(pem) = &self.authorities_pem {
            for certificate in certificates(pem, CertificateOf::Authorities)? {
                authorities.add(certificate).map_err(BrokerTlsError::Authority)?;
            }
            return Ok(authorities);
        }
        let of_system = rustls_native_certs::load_native_certs();
        // A system has some that are too old to be read.
        authorities.add_parsable_certificates(of_system.certs);
        if authorities.is_empty() {
            let reasons: Vec<String> = of_system.errors.iter().map(ToString::to_string).collect();
            return Err(BrokerTlsError::NoSystemAuthorities { reason: reasons.join(", ") });
        }
        Ok(authorities)
    }
}

/// The certificates of a text in PEM, at least one.
fn certificates(pem: &[u8], of: CertificateOf) -> Result<Vec<CertificateDer<'static>>, BrokerTlsError> {
    let read: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    let certificates = read.map_err(|source| BrokerTlsError::NoPem { of, source })?;
    if certificates.is_empty() { Err(BrokerTlsError::NoCertificate(of)) } else { Ok(certificates) }
}
