//! Join tokens: what a newcomer shows instead of a certificate, once.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::rand::{SecureRandom, SystemRandom};

/// Bytes of a token's secret: nobody guesses that many.
const SECRET_BYTES: usize = 32;

/// Names a token without giving it away.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct TokenId([u8; 6]);

/// A token. Its text is shown to whoever made it, and is kept nowhere.
#[derive(Clone, PartialEq, Eq)]
pub struct Token {
    /// Names it.
    pub id: TokenId,
    secret: [u8; SECRET_BYTES],
}

/// A text that is no token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TokenTextError {
    /// Another form.
    #[error(
        "that is no token: one looks like tessera-0123456789ab-..., as coordinator token create prints it"
    )]
    Form,
    /// A name that is none.
    #[error("that is no token's name: one has 12 hexadecimal digits, as coordinator token list shows")]
    Name,
}

/// Bytes that nobody can foresee.
pub(crate) fn random<const N: usize>() -> [u8; N] {
    let mut bytes = [0; N];
    SystemRandom::new().fill(&mut bytes).expect("the operating system gives random bytes");
    bytes
}

impl TokenId {
    pub(crate) fn random() -> Self {
        Self(random())
    }

    /// Of certificates that the authority's own folder holds.
    pub const LOCAL: Self = Self([0; 6]);
}

impl std::fmt::Display for TokenId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::fmt::Debug for TokenId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "TokenId({self})")
    }
}

impl std::str::FromStr for TokenId {
    type Err = TokenTextError;

    fn from_str(text: &str) -> Result<Self, TokenTextError> {
        if text.len() != 12 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(TokenTextError::Name);
        }
        let mut id = [0; 6];
        for (byte, at) in id.iter_mut().zip((0..12).step_by(2)) {
            *byte = u8::from_str_radix(&text[at..at + 2], 16).map_err(|_| TokenTextError::Name)?;
        }
        Ok(Self(id))
    }
}

impl Token {
    pub(crate) fn random() -> Self {
        Self { id: TokenId::random(), secret: random() }
    }

    /// What is kept of it. Comparing takes the same time whatever differs.
    pub(crate) fn digest(&self) -> blake3::Hash {
        blake3::hash(&self.secret)
    }

    /// As it is handed over.
    pub fn text(&self) -> String {
        format!("tessera-{}-{}", self.id, URL_SAFE_NO_PAD.encode(self.secret))
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Token({}, ..)", self.id)
    }
}

impl std::str::FromStr for Token {
    type Err = TokenTextError;

    fn from_str(text: &str) -> Result<Self, TokenTextError> {
        let rest = text.trim().strip_prefix("tessera-").ok_or(TokenTextError::Form)?;
        let (id, secret) = rest.split_once('-').ok_or(TokenTextError::Form)?;
        let secret = URL_SAFE_NO_PAD.decode(secret).ok().and_then(|bytes| bytes.try_into().ok());
        match (id.parse(), secret) {
            (Ok(id), Some(secret)) => Ok(Self { id, secret }),
            _ => Err(TokenTextError::Form),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_read_as_it_was_written_and_shows_nothing_in_logs() {
        let token = Token::random();
        assert_eq!(format!(" {}\n", token.text()).parse(), Ok(token.clone()));
        let shown = format!("{token:?}");
        assert!(shown.contains(&token.id.to_string()) && !token.text().contains(&shown) && shown.len() < 30);
        let text = token.text();
        for wrong in
            ["", "tessera-", "tessera-00-aa", &text[1..], &text[..text.len() - 1], "tessera-äöüäöü-x"]
        {
            assert_eq!(wrong.parse::<Token>(), Err(TokenTextError::Form), "{wrong}");
        }
        assert!("äöüäöü".parse::<TokenId>().is_err());
    }
}
