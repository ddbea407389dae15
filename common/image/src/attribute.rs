//! The one custom attribute of our EXR files: a JSON text.
//!
//! The EXR library keeps custom attributes in a hash map and writes them in its order, so two of them would give other bytes
//! from run to run. One cannot.

use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::LayerAttributes;
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Write;

/// Name of the attribute.
const NAME: &str = "tessera";

/// Puts `value` into `attributes` as JSON. EXR texts have no encoding, so the JSON is pure ASCII.
pub(crate) fn insert(attributes: &mut LayerAttributes, value: &impl Serialize) {
    let json = serde_json::to_string(value).expect("plain data serialises");
    let text = Text::new_or_panic(escaped(&json));
    attributes.other.insert(Text::new_or_panic(NAME), AttributeValue::Text(text));
}

/// The value that `attributes` carry; none without the attribute, an error sentence if it is there and at fault.
pub(crate) fn find<T: DeserializeOwned>(attributes: &LayerAttributes) -> Option<Result<T, String>> {
    let value = attributes.other.get(&Text::new_or_panic(NAME))?;
    let AttributeValue::Text(text) = value else {
        return Some(Err(format!("its attribute {NAME:?} is no text")));
    };
    Some(serde_json::from_slice(text.as_slice()).map_err(|err| format!("its attribute {NAME:?}: {err}")))
}

/// `json` with everything beyond ASCII as `\u` escapes; such characters only ever stand inside JSON strings.
fn escaped(json: &str) -> String {
    let mut ascii = String::with_capacity(json.len());
    for character in json.chars() {
        if character.is_ascii() {
            ascii.push(character);
        } else {
            for unit in character.encode_utf16(&mut [0; 2]) {
                write!(ascii, "\\u{unit:04x}").expect("writing to a string succeeds");
            }
        }
    }
    ascii
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_beyond_ascii_survives() {
        let json = serde_json::to_string("Wohnküche 🙂").unwrap();
        assert!(escaped(&json).is_ascii());
        assert_eq!(serde_json::from_str::<String>(&escaped(&json)).unwrap(), "Wohnküche 🙂");
    }
}
