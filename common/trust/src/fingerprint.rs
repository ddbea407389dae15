//! How a farm is recognised before anything of it is trusted.

use rustls::pki_types::CertificateDer;

/// SHA-256 of an authority's certificate; what `openssl x509 -fingerprint -sha256` shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Fingerprint([u8; 32]);

/// A text that is no fingerprint.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no fingerprint: it has 64 hexadecimal digits")]
pub struct FingerprintError(String);

impl Fingerprint {
    /// Of a certificate.
    pub fn of(certificate: &CertificateDer<'_>) -> Self {
        let digest = ring::digest::digest(&ring::digest::SHA256, certificate);
        Self(digest.as_ref().try_into().expect("SHA-256 has 32 bytes"))
    }
}

impl std::fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::str::FromStr for Fingerprint {
    type Err = FingerprintError;

    /// Takes lower and upper case, with and without colons between the bytes.
    fn from_str(text: &str) -> Result<Self, FingerprintError> {
        let bad = || FingerprintError(text.chars().take(100).collect());
        let digits: Option<Vec<u8>> =
            text.chars().filter(|c| *c != ':').map(|c| c.to_digit(16).map(|digit| digit as u8)).collect();
        let bytes: Vec<u8> =
            digits.ok_or_else(bad)?.chunks(2).map(|pair| pair[0] << 4 | pair.get(1).unwrap_or(&0)).collect();
        let odd = text.chars().filter(|c| *c != ':').count() != 64;
        if odd { Err(bad()) } else { bytes.try_into().map(Self).map_err(|_| bad()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_common_way_of_writing_is_read() {
        let print = Fingerprint::of(&CertificateDer::from(b"certificate".to_vec()));
        let plain = print.to_string();
        assert_eq!(plain.len(), 64);
        let pairs: Vec<String> =
            plain.as_bytes().chunks(2).map(|pair| String::from_utf8_lossy(pair).to_uppercase()).collect();
        for text in [plain.clone(), plain.to_uppercase(), pairs.join(":")] {
            assert_eq!(text.parse(), Ok(print));
        }
        for text in ["", "ab", &plain[1..], &format!("{plain}0"), &plain.replace(&plain[..1], "g")] {
            assert!(text.parse::<Fingerprint>().is_err(), "{text}");
        }
    }
}
