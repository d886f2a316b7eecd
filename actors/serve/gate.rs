//! Who is let in: by the host that was asked for, the page that asks, the token that it has.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;

/// Wrong tokens of an address in a minute after which it is not listened to for the rest of it.
const WRONG: usize = 5;
const MINUTE: f64 = 60.0;
/// Addresses whose wrong tokens are remembered.
const REMEMBERED: usize = 1024;

/// A secret in an address: whoever has it is let in.
#[derive(Clone, Debug)]
pub struct Token {
    text: String,
    /// Hashes are compared, in constant time.
    hash: blake3::Hash,
}

/// What a token is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    /// To drive, and all else.
    Drive,
    /// To look.
    Watch,
}

impl Token {
    /// 128 random bits.
    ///
    /// # Errors
    /// If the system has none.
    pub fn random() -> Result<Self, String> {
        let mut bits = [0; 16];
        getrandom::fill(&mut bits).map_err(|e| format!("the system gives no random numbers: {e}"))?;
        Ok(Self::of(URL_SAFE_NO_PAD.encode(bits)))
    }

    /// One that was kept. `None` where it is too short to be a secret, or could not stand in an address.
    pub fn kept(text: &str) -> Option<Self> {
        let text = text.trim();
        let fits = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        ((20..=128).contains(&text.len()) && text.chars().all(fits)).then(|| Self::of(text.to_owned()))
    }

    fn of(text: String) -> Self {
        let hash = blake3::hash(text.as_bytes());
        Self { text, hash }
    }

    /// As it stands in an address.
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Whether it is this one; takes as long whatever is wrong with that.
    pub fn is(&self, text: &str) -> bool {
        self.hash == blake3::hash(text.as_bytes())
    }
}

/// Names by which the server may be asked for: those that a page from elsewhere cannot make a browser believe in.
#[derive(Clone, Debug)]
pub struct Hosts(Vec<String>);

impl Hosts {
    /// Of who listens at `address`, and is known as `names`, with or without port.
    pub fn new(address: SocketAddr, names: &[String]) -> Self {
        let port = address.port();
        let mut hosts = vec![address.to_string()];
        if address.ip().is_loopback() {
            hosts.extend([format!("localhost:{port}"), format!("127.0.0.1:{port}"), format!("[::1]:{port}")]);
        }
        for name in names {
            let name = name.to_ascii_lowercase();
            hosts.extend([format!("{name}:{port}"), name]);
        }
        Self(hosts)
    }

    /// Whether a request with this `Host` is for us.
    pub fn knows(&self, host: &str) -> bool {
        let host = host.to_ascii_lowercase();
        // Browsers leave the usual ports out.
        self.0.contains(&host) || ["80", "443"].iter().any(|port| self.0.contains(&format!("{host}:{port}")))
    }

    /// Whether a page of this `Origin` is one that this `Host` gave out.
    pub fn is_own(&self, host: &str, origin: &str) -> bool {
        let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        self.knows(host) && authority.is_some_and(|a| a.eq_ignore_ascii_case(host))
    }
}

/// The tokens, and who guesses at them.
#[derive(Clone, Debug)]
pub struct Gate {
    drive: Token,
    watch: Option<Token>,
    /// Times of wrong tokens.
    wrong: BTreeMap<IpAddr, Vec<f64>>,
}

impl Gate {
    /// Lets in who has one of these.
    pub fn new(drive: Token, watch: Option<Token>) -> Self {
        Self { drive, watch, wrong: BTreeMap::new() }
    }

    /// What somebody with this token may do. `None`: nothing, also where it is right but the address has guessed too often.
    pub fn pass(&mut self, address: IpAddr, token: &str, now: f64) -> Option<Pass> {
        let times = self.wrong.get_mut(&address);
        let guesses = times.map_or(0, |times| {
            times.retain(|at| now - at < MINUTE);
            times.len()
        });
        if guesses >= WRONG {
            return None;
        }
        // All are compared, whichever it is.
        let drives = self.drive.is(token);
        let watches = self.watch.as_ref().is_some_and(|watch| watch.is(token));
        match (drives, watches) {
            (true, _) => Some(Pass::Drive),
            (false, true) => Some(Pass::Watch),
            (false, false) => {
                if self.wrong.len() >= REMEMBERED {
                    self.wrong.retain(|_, times| times.iter().any(|at| now - at < MINUTE));
                }
                if self.wrong.len() < REMEMBERED || self.wrong.contains_key(&address) {
                    self.wrong.entry(address).or_default().push(now);
                }
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_random_and_compared_whole() {
        let (a, b) = (Token::random().expect("a token"), Token::random().expect("a token"));
        assert_ne!(a.as_str(), b.as_str());
        assert_eq!(a.as_str().len(), 22);
        assert!(a.is(a.as_str()) && !a.is(b.as_str()) && !a.is("") && !a.is(&a.as_str()[..21]));
        assert!(Token::kept(a.as_str()).is_some_and(|kept| kept.is(a.as_str())));
        assert!(Token::kept("short").is_none() && Token::kept("with blanks in it, and long").is_none());
    }

    #[test]
    fn only_known_hosts_and_their_own_pages_are_let_in() {
        let address = "127.0.0.1:8080".parse().expect("an address");
        let hosts = Hosts::new(address, &["Walk.example".into()]);
        for host in
            ["127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080", "walk.example", "walk.example:8080"]
        {
            assert!(hosts.knows(host), "{host}");
        }
        for host in ["", "evil.example", "127.0.0.1", "127.0.0.1:80", "localhost:8080.evil.example", "8080"] {
            assert!(!hosts.knows(host), "{host}");
        }
        assert!(hosts.is_own("localhost:8080", "http://localhost:8080"));
        assert!(hosts.is_own("walk.example", "https://walk.example"));
        for origin in ["null", "http://evil.example", "http://127.0.0.1:8080", "http://localhost", "file://"]
        {
            assert!(!hosts.is_own("localhost:8080", origin), "{origin}");
        }
        assert!(!hosts.is_own("evil.example", "http://evil.example"));
        let elsewhere = Hosts::new("192.0.2.1:80".parse().expect("an address"), &[]);
        assert!(!elsewhere.knows("localhost:80") && elsewhere.knows("192.0.2.1:80"));
        let encrypted = Hosts::new("192.0.2.1:443".parse().expect("an address"), &[]);
        assert!(encrypted.is_own("192.0.2.1", "https://192.0.2.1"));
    }

    #[test]
    fn who_guesses_is_not_listened_to() {
        let (drive, watch) = (Token::random().expect("a token"), Token::random().expect("a token"));
        let mut gate = Gate::new(drive.clone(), Some(watch.clone()));
        let [bad, good] = ["192.0.2.1", "192.0.2.2"].map(|a| a.parse().expect("an address"));
        assert_eq!(gate.pass(good, watch.as_str(), 0.0), Some(Pass::Watch));
        for i in 0..WRONG {
            assert_eq!(gate.pass(bad, "guess", i as f64), None);
        }
        assert_eq!(gate.pass(bad, drive.as_str(), 10.0), None);
        assert_eq!(gate.pass(good, drive.as_str(), 10.0), Some(Pass::Drive));
        assert_eq!(gate.pass(bad, drive.as_str(), 70.0), Some(Pass::Drive));
        for i in 0..5000_u32 {
            gate.pass(IpAddr::from(i.to_be_bytes()), "guess", 100.0);
        }
        assert!(gate.wrong.len() <= REMEMBERED);
    }
}
