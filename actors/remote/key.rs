//! Who may trace for a walk: whoever has its key, a secret of 32 bytes that the walk makes and prints with its address.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;

/// A secret that a walk and its guests share.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; 32]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(…)")
    }
}

impl Key {
    /// A new one.
    ///
    /// # Errors
    /// If the system has no randomness to give.
    pub fn new() -> Result<Self, String> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes).map_err(|e| format!("no key can be made: {e}"))?;
        Ok(Self(bytes))
    }

    /// What proves that one has the key to whoever asked with `nonce`, as one of two sides.
    pub fn proof(&self, side: &str, nonce: &[u8; 32]) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(side.as_bytes());
        hasher.update(nonce);
        *hasher.finalize().as_bytes()
    }

    /// What the signing key of one of two sides is made of, for links that know each side by one.
    pub fn seed(&self, side: &str) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("foveal tracers: a side's signing key");
        hasher.update(&self.0);
        hasher.update(side.as_bytes());
        *hasher.finalize().as_bytes()
    }

    /// Whether `proof` is the one for `side`; takes as long whatever differs.
    pub fn is_proof(&self, side: &str, nonce: &[u8; 32], proof: &[u8; 32]) -> bool {
        blake3::Hash::from(self.proof(side, nonce)) == blake3::Hash::from(*proof)
    }
}

/// An invitation to a walk: where it is, and the key. As text `fvj1-…`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invitation {
    /// Link and address, `tcp/127.0.0.1:7447`.
    pub address: String,
    /// The secret.
    pub key: Key,
}

/// What every invitation begins with.
const PREFIX: &str = "fvj1-";
/// Most characters of an address.
const ADDRESS_BYTES_MAX: usize = 200;

impl fmt::Display for Invitation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut bytes = self.key.0.to_vec();
        bytes.extend_from_slice(self.address.as_bytes());
        write!(f, "{PREFIX}{}", URL_SAFE_NO_PAD.encode(bytes))
    }
}

impl FromStr for Invitation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("this is no key: it begins with {PREFIX} and is printed by the walk");
        let bytes = text.trim().strip_prefix(PREFIX).and_then(|rest| URL_SAFE_NO_PAD.decode(rest).ok());
        let bytes = bytes.ok_or_else(wrong)?;
        let (key, address) = bytes.split_first_chunk::<32>().ok_or_else(wrong)?;
        if address.is_empty() || address.len() > ADDRESS_BYTES_MAX {
            return Err(wrong());
        }
        let address = std::str::from_utf8(address).map_err(|_| wrong())?.to_owned();
        Ok(Self { address, key: Key(*key) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invitation_is_read_as_it_was_written() {
        let made = Invitation { address: "tcp/127.0.0.1:7447".into(), key: Key::new().unwrap() };
        let text = made.to_string();
        assert_eq!(text.parse(), Ok(made.clone()));
        assert_eq!(format!(" {text}\n").parse(), Ok(made.clone()));
        assert!(!format!("{made:?}").contains(&text[10..20]), "a key is no text for logs");
        for wrong in ["", "fvj1-", "fvj1-AAAA", "x", &text[1..], &text[..40]] {
            assert!(wrong.parse::<Invitation>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_proof_is_of_one_key_side_and_question() {
        let (key, other, nonce) = (Key::new().unwrap(), Key::new().unwrap(), [7; 32]);
        let proof = key.proof("guest", &nonce);
        assert!(key.is_proof("guest", &nonce, &proof));
        assert!(!key.is_proof("walk", &nonce, &proof) && !other.is_proof("guest", &nonce, &proof));
        assert!(!key.is_proof("guest", &[8; 32], &proof));
    }
}
