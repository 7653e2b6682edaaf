//! Changes of a glTF document.

use serde_json::{Value, json};

/// A list of an object, if it has it: indexing would put one there.
pub(super) fn array<'v>(value: &'v mut Value, key: &str) -> Option<&'v mut Vec<Value>> {
    value.get_mut(key).and_then(Value::as_array_mut)
}

/// The elements of a list of an object.
pub(super) fn list<'v>(value: &'v mut Value, key: &str) -> impl Iterator<Item = &'v mut Value> {
    array(value, key).into_iter().flatten()
}

/// Removes a key of an object.
pub(super) fn remove(value: &mut Value, key: &str) {
    if let Some(object) = value.as_object_mut() {
        object.remove(key);
    }
}

/// Adds to a list of an object, which is made if need be; returns the new element's number.
pub(super) fn push(value: &mut Value, key: &str, element: Value) -> usize {
    if !value[key].is_array() {
        value[key] = json!([]);
    }
    value[key].as_array_mut().map_or(0, |list| {
        list.push(element);
        list.len() - 1
    })
}

/// Removes extensions of a part of the document.
pub(super) fn remove_extensions(part: &mut Value, names: &[&str]) {
    let left = part.get_mut("extensions").and_then(Value::as_object_mut);
    if left.is_none_or(|extensions| {
        extensions.retain(|name, _| !names.contains(&name.as_str()));
        extensions.is_empty()
    }) {
        remove(part, "extensions");
    }
}

/// Removes extensions from the lists of those that the document uses.
pub(super) fn forget_extensions(root: &mut Value, names: &[&str]) {
    for key in ["extensionsUsed", "extensionsRequired"] {
        if array(root, key).is_none_or(|used| {
            used.retain(|name| !name.as_str().is_some_and(|n| names.contains(&n)));
            used.is_empty()
        }) {
            remove(root, key);
        }
    }
}
