//! Properties that core glTF does not know: values of `extras` and of extensions, checked for kind and range.

use crate::error::{Fault, Place};
use gltf::json::Extras;
use serde_json::{Map, Value};

/// An object of unchecked values.
pub(crate) struct Fields {
    /// How a place is to call the object; empty when the place has its name already.
    origin: &'static str,
    values: Map<String, Value>,
}

impl Fields {
    /// The values of `extras`; whatever is no object has none.
    pub fn of_extras(extras: &Extras) -> Self {
        let parsed = extras.as_ref().and_then(|raw| serde_json::from_str(raw.get()).ok());
        Self { origin: "extras", values: parsed.unwrap_or_default() }
    }

    /// The values of the extension called `name`, if it is there.
    pub fn of_extension(
        name: &'static str,
        extensions: Option<&Map<String, Value>>,
        place: &Place,
    ) -> Result<Option<Self>, Fault> {
        match extensions.and_then(|extensions| extensions.get(name)) {
            None => Ok(None),
            Some(Value::Object(values)) => Ok(Some(Self { origin: name, values: values.clone() })),
            Some(_) => Err(place.field(name).fault("must be an object")),
        }
    }

    /// The object within this one, if it is there.
    pub fn object(&self, key: &str, place: &Place) -> Result<Option<Self>, Fault> {
        let read =
            |value: &Value| value.as_object().map(|values| Self { origin: "", values: values.clone() });
        self.get(key, place, "an object", read)
    }

    /// A finite number.
    pub fn number(&self, key: &str, place: &Place) -> Result<Option<f32>, Fault> {
        self.get(key, place, "a number", finite)
    }

    /// A finite number > 0.
    pub fn positive(&self, key: &str, place: &Place) -> Result<Option<f32>, Fault> {
        self.get(key, place, "a number greater than 0", |value| finite(value).filter(|&number| number > 0.0))
    }

    /// A finite number >= 0.
    pub fn not_negative(&self, key: &str, place: &Place) -> Result<Option<f32>, Fault> {
        self.get(key, place, "a number not less than 0", |value| {
            finite(value).filter(|&number| number >= 0.0)
        })
    }

    /// Finite numbers, `N` of them.
    pub fn numbers<const N: usize>(&self, key: &str, place: &Place) -> Result<Option<[f32; N]>, Fault> {
        self.get(key, place, &format!("an array of {N} numbers"), |value| {
            let numbers: Option<Vec<f32>> = value.as_array()?.iter().map(finite).collect();
            numbers?.try_into().ok()
        })
    }

    /// A whole number.
    pub fn count(&self, key: &str, place: &Place) -> Result<Option<u32>, Fault> {
        self.get(key, place, "a whole number not less than 0", |value| value.as_u64()?.try_into().ok())
    }

    /// True or false.
    pub fn boolean(&self, key: &str, place: &Place) -> Result<Option<bool>, Fault> {
        self.get(key, place, "true or false", Value::as_bool)
    }

    /// A text.
    pub fn text(&self, key: &str, place: &Place) -> Result<Option<String>, Fault> {
        self.get(key, place, "a string", |value| value.as_str().map(str::to_owned))
    }

    /// A list of objects; none when it is not there.
    pub fn objects(&self, key: &str, place: &Place) -> Result<Vec<Self>, Fault> {
        let object =
            |value: &Value| value.as_object().map(|values| Self { origin: "", values: values.clone() });
        let read = |value: &Value| value.as_array()?.iter().map(object).collect();
        Ok(self.get(key, place, "an array of objects", read)?.unwrap_or_default())
    }

    fn get<T>(
        &self,
        key: &str,
        place: &Place,
        wanted: &str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Result<Option<T>, Fault> {
        let Some(value) = self.values.get(key) else { return Ok(None) };
        let name = if self.origin.is_empty() { key.to_owned() } else { format!("{}.{key}", self.origin) };
        let wrong = || place.field(&name).fault(format!("must be {wanted}"));
        read(value).map(Some).ok_or_else(wrong)
    }
}

/// The value as a finite number.
#[expect(clippy::cast_possible_truncation, reason = "what does not fit is infinite and so refused")]
fn finite(value: &Value) -> Option<f32> {
    value.as_f64().map(|number| number as f32).filter(|number| number.is_finite())
}
