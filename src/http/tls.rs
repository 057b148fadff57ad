//! TLS: certificate and private key from PEM files, checked before they are put in force.

use std::path::Path;
use std::sync::Arc;

use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use x509_parser::prelude::{FromDer, X509Certificate};

/// What the server needs for handshakes.
pub type Tls = Arc<ServerConfig>;

/// Protocols that are offered by ALPN, the preferred one first.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// Reads a chain of certificates, the server's own first, and its private key.
///
/// # Errors
/// A file cannot be read, the certificate has expired or is not valid yet, or the key is not that of the certificate. The text names
/// the file and the flag.
pub fn load(certificates: &Path, key: &Path) -> Result<Tls, String> {
    let at = |flag: &str, path: &Path, what: &dyn std::fmt::Display| {
        format!("--{flag} {}: {what}", path.display())
    };
    let in_certificates = |what: &dyn std::fmt::Display| at("tls-cert", certificates, what);
    let in_key = |what: &dyn std::fmt::Display| at("tls-key", key, what);
    let chain = CertificateDer::pem_file_iter(certificates)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| in_certificates(&error))?;
    let own = chain.first().ok_or_else(|| in_certificates(&"no certificate in PEM form"))?;
    check_dates(own).map_err(|what| in_certificates(&what))?;
    let private = PrivateKeyDer::from_pem_file(key).map_err(|error| in_key(&error))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, private))
        .map_err(|error| {
            in_key(&format!(
                "cannot be used with the certificate of {}: {error}",
                certificates.display()
            ))
        })?;
    config.alpn_protocols = PROTOCOLS.iter().map(|name| name.to_vec()).collect();
    Ok(Arc::new(config))
}

/// Checks that the certificate is valid now.
fn check_dates(certificate: &CertificateDer<'_>) -> Result<(), String> {
    let (_, parsed) = X509Certificate::from_der(certificate)
        .map_err(|error| format!("the certificate cannot be read: {error}"))?;
    let validity = parsed.validity();
    if validity.is_valid() {
        return Ok(());
    }
    Err(format!(
        "the certificate is valid from {} to {} only; get a new one",
        validity.not_before, validity.not_after
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rcgen::{CertificateParams, KeyPair};

    /// Writes a certificate for `localhost` that is valid until the end of a year, and its key.
    fn write(folder: &Path, name: &str, until_year: i32) -> [std::path::PathBuf; 2] {
        let pair = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
        params.not_before = rcgen::date_time_ymd(2000, 1, 1);
        params.not_after = rcgen::date_time_ymd(until_year, 12, 31);
        let paths = ["crt", "key"].map(|kind| folder.join(format!("{name}.{kind}")));
        std::fs::write(&paths[0], params.self_signed(&pair).unwrap().pem()).unwrap();
        std::fs::write(&paths[1], pair.serialize_pem()).unwrap();
        paths
    }

    #[test]
    fn only_a_pair_that_works_is_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let [certificate, key] = write(folder.path(), "a", 2090);
        let [_, other_key] = write(folder.path(), "b", 2090);
        let [old, old_key] = write(folder.path(), "old", 2001);
        let fault = |certificate: &Path, key: &Path| load(certificate, key).unwrap_err();
        assert_eq!(load(&certificate, &key).unwrap().alpn_protocols.len(), 2);
        assert!(fault(&certificate, &other_key).contains("b.key: cannot be used with"));
        let expired = fault(&old, &old_key);
        assert!(expired.contains("--tls-cert") && expired.contains("2001"), "{expired}");
        assert!(fault(&key, &key).contains("no certificate"));
        assert!(fault(&certificate, &certificate).contains("--tls-key"));
        assert!(fault(Path::new("/none"), &key).contains("/none"));
    }
}
