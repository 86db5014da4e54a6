//! The fleet's private certificate authority.

use super::error::FleetError;
use rcgen::{
    BasicConstraints, Certificate, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

/// How long the authority is valid, days.
const AUTHORITY_DAYS: i64 = 3650;
/// Certificates are valid from this long before now, since clocks differ.
const CLOCK_DIFFERENCE: Duration = Duration::days(1);

/// How long a certificate is valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Validity {
    /// Seconds from now; one that is negative has expired.
    pub seconds: i64,
}

impl Default for Validity {
    fn default() -> Self {
        Self::days(365)
    }
}

impl Validity {
    /// So many days from now.
    pub const fn days(days: i64) -> Self {
        Self { seconds: Duration::days(days).whole_seconds() }
    }

    fn apply(self, params: &mut CertificateParams) {
        let now = OffsetDateTime::now_utc();
        params.not_after = now + Duration::seconds(self.seconds);
        params.not_before = now.min(params.not_after) - CLOCK_DIFFERENCE;
    }
}

/// Signs the certificates of the members.
#[derive(Debug)]
pub struct Authority {
    certificate: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// A new authority.
    ///
    /// # Returns
    /// The authority, and its private key in PEM.
    ///
    /// # Errors
    /// [`FleetError::Certificate`].
    pub fn new() -> Result<(Self, String), FleetError> {
        let key = KeyPair::generate()?;
        let mut params = CertificateParams::new(Vec::new())?;
        params.distinguished_name.push(DnType::CommonName, "authority of a fleet");
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        Validity::days(AUTHORITY_DAYS).apply(&mut params);
        let certificate = params.self_signed(&key)?.pem();
        let secret = key.serialize_pem();
        Ok((Self { certificate, issuer: Issuer::new(params, key) }, secret))
    }

    /// Reads an authority from its certificate and private key, both PEM.
    ///
    /// # Errors
    /// [`FleetError::Certificate`].
    pub fn read(certificate: &str, key: &str) -> Result<Self, FleetError> {
        let issuer = Issuer::from_ca_cert_pem(certificate, KeyPair::from_pem(key)?)?;
        Ok(Self { certificate: certificate.to_owned(), issuer })
    }

    /// The authority's own certificate, PEM.
    pub fn certificate(&self) -> &str {
        &self.certificate
    }

    /// Makes a key and a certificate.
    ///
    /// # Arguments
    /// * `common_name`: who it is.
    /// * `addresses`: names and IP addresses under which it may be listened. Without any, the certificate is of use to
    ///   one who connects only: nobody can pose as the hub with a robot's.
    ///
    /// # Returns
    /// Certificate and private key, PEM.
    ///
    /// # Errors
    /// [`FleetError::Certificate`].
    pub fn issue(
        &self,
        common_name: &str,
        addresses: Vec<String>,
        validity: Validity,
    ) -> Result<(String, String), FleetError> {
        let mut usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        if !addresses.is_empty() {
            usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        }
        let key = KeyPair::generate()?;
        let mut params = CertificateParams::new(addresses)?;
        params.distinguished_name.push(DnType::CommonName, common_name);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = usages;
        params.use_authority_key_identifier_extension = true;
        validity.apply(&mut params);
        let certificate: Certificate = params.signed_by(&key, &self.issuer)?;
        Ok((certificate.pem(), key.serialize_pem()))
    }
}
