//! Certificates: connections that nobody on the way can read.

use std::path::Path;
use std::sync::Arc;

use foveal_engine::Failure;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{Error as PemError, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{Error, ServerConfig};
use tokio_rustls::server::TlsStream;

/// A certificate and its key.
#[derive(Clone)]
pub struct Tls(TlsAcceptor);

impl std::fmt::Debug for Tls {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Tls")
    }
}

impl Tls {
    /// What speaks it.
    pub const BY: &'static str = "rustls with ring, TLS 1.2 and 1.3";

    /// Reads a certificate, with those that lead to it, and its key from two files in PEM.
    ///
    /// # Errors
    /// If a file cannot be read or holds nothing of the kind, or the key is another certificate's.
    pub fn read(certificate: &Path, key: &Path) -> Result<Self, Failure> {
        let chain: Result<Vec<_>, _> =
            CertificateDer::pem_file_iter(certificate).and_then(|certificates| certificates.collect());
        let chain = chain.map_err(|e| unread(certificate, &e))?;
        if chain.is_empty() {
            return Err(Failure::file(
                certificate,
                "holds no certificate; it must have one in PEM, which begins with -----BEGIN CERTIFICATE-----",
            ));
        }
        let private = PrivateKeyDer::from_pem_file(key).map_err(|e| match e {
            PemError::NoItemsFound => Failure::file(
                key,
                "holds no private key; it must have one in PEM, which begins with -----BEGIN PRIVATE KEY-----",
            ),
            e => unread(key, &e),
        })?;
        let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let builder = builder.with_safe_default_protocol_versions();
        let config = builder.and_then(|b| b.with_no_client_auth().with_single_cert(chain, private));
        let mut config = config.map_err(|e| match e {
            Error::InconsistentKeys(_) => Failure::file(
                key,
                format!(
                    "is not the key of the certificate in {}; give both of one pair",
                    certificate.display()
                ),
            ),
            e @ Error::InvalidCertificate(_) => {
                Failure::file(certificate, format!("{e}; have the certificate made anew"))
            }
            e => {
                Failure::file(key, format!("{e}; have the key made anew: ECDSA, Ed25519 or RSA, in PKCS #8"))
            }
        })?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(Self(TlsAcceptor::from(Arc::new(config))))
    }

    pub(super) async fn accept(&self, stream: TcpStream) -> std::io::Result<TlsStream<TcpStream>> {
        self.0.accept(stream).await
    }
}

fn unread(file: &Path, e: &PemError) -> Failure {
    match e {
        PemError::Io(e) => Failure::file(file, e),
        e => Failure::file(file, format!("is no file in PEM: {e}")),
    }
}
