//! Who a side of an encrypted link is: an Ed25519 key made of the walk's secret, shown as a raw public key (RFC 7250).
//!
//! Both sides know both keys, so that there are no certificates to make, copy and renew: whoever has the secret is let in,
//! and finds the walk that it belongs to. TLS signs for server and client apart, so that nobody passes a proof on.

use std::sync::Arc;

use rustls::client::AlwaysResolvesClientRawPublicKeys;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, WebPkiSupportedAlgorithms, ring, verify_tls13_signature_with_raw_key};
use rustls::pki_types::{CertificateDer, PrivatePkcs8KeyDer, ServerName, SubjectPublicKeyInfoDer, UnixTime};
use rustls::server::AlwaysResolvesServerRawPublicKeys;
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::sign::CertifiedKey;
use rustls::version::TLS13;
use rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, DistinguishedName, Error, PeerIncompatible,
    ServerConfig, SignatureScheme,
};

use crate::key::Key;

/// What is spoken inside.
const PROTOCOL: &[u8] = b"foveal/1";
/// The walk's side, and the other one.
const SIDES: [&str; 2] = ["walk", "guest"];
/// What stands before a seed in an Ed25519 key as PKCS #8 has it (RFC 8410).
const PKCS8: [u8; 16] =
    [0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20];

/// The walk's side of TLS 1.3 for who has `key`.
///
/// # Errors
/// If there is no cryptography for it here.
pub fn of_walk(key: &Key) -> Result<ServerConfig, String> {
    let provider = Arc::new(ring::default_provider());
    let [own, other] = SIDES.map(|side| certified(key, side));
    let only = Only::new(&other?, &provider)?;
    let builder = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])
        .map_err(|e| e.to_string())?;
    let mut config = builder
        .with_client_cert_verifier(Arc::new(only))
        .with_cert_resolver(Arc::new(AlwaysResolvesServerRawPublicKeys::new(Arc::new(own?))));
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    Ok(config)
}

/// The guest's side.
///
/// # Errors
/// If there is no cryptography for it here.
pub fn of_guest(key: &Key) -> Result<ClientConfig, String> {
    let provider = Arc::new(ring::default_provider());
    let [other, own] = SIDES.map(|side| certified(key, side));
    let only = Only::new(&other?, &provider)?;
    let builder = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])
        .map_err(|e| e.to_string())?;
    let mut config = builder
        .dangerous() // names of certificates are left out, because there are none
        .with_custom_certificate_verifier(Arc::new(only))
        .with_client_cert_resolver(Arc::new(AlwaysResolvesClientRawPublicKeys::new(Arc::new(own?))));
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    Ok(config)
}

fn certified(key: &Key, side: &str) -> Result<CertifiedKey, String> {
    let mut der = PKCS8.to_vec();
    der.extend_from_slice(&key.seed(side));
    let signs = ring::sign::any_eddsa_type(&PrivatePkcs8KeyDer::from(der)).map_err(|e| e.to_string())?;
    let public = signs.public_key().ok_or("a signing key without a public one")?.to_vec();
    Ok(CertifiedKey::new(vec![CertificateDer::from(public)], signs))
}

/// Takes one public key, and no other.
#[derive(Debug)]
struct Only {
    public: Vec<u8>,
    algorithms: WebPkiSupportedAlgorithms,
}

impl Only {
    fn new(of: &CertifiedKey, provider: &CryptoProvider) -> Result<Self, String> {
        let public = of.cert.first().ok_or("no public key")?.to_vec();
        Ok(Self { public, algorithms: provider.signature_verification_algorithms })
    }

    fn check(&self, shown: &CertificateDer<'_>) -> Result<(), Error> {
        // A public key, which needs no constant time.
        if shown.as_ref() == self.public.as_slice() {
            return Ok(());
        }
        Err(Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
    }

    fn signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let key = SubjectPublicKeyInfoDer::from(shown.as_ref());
        verify_tls13_signature_with_raw_key(message, &key, signed, &self.algorithms)
    }
}

/// TLS 1.2 is never spoken.
fn no_tls12() -> Result<HandshakeSignatureValid, Error> {
    Err(Error::PeerIncompatible(PeerIncompatible::Tls13RequiredForQuic))
}

impl ServerCertVerifier for Only {
    fn verify_server_cert(
        &self,
        shown: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        self.check(shown).map(|()| ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        no_tls12()
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.signature(message, shown, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ED25519]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}

impl ClientCertVerifier for Only {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        shown: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        self.check(shown).map(|()| ClientCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        no_tls12()
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        shown: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.signature(message, shown, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ED25519]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}
