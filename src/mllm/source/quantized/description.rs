//! Where a folder says how its layers are packed.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles};
use serde_json::Value;
use std::path::PathBuf;

/// The name that folders of MLX get here; they name no method.
pub(super) const MLX: &str = "mlx";

/// Keys of `config.json` that lead to a description, and the method where it names none.
const IN_CONFIG: [(&[&str], Option<&str>); 4] = [
    (&["quantization_config"], None),
    (&["text_config", "quantization_config"], None),
    (&["quantization"], None),
    (&["compression_config"], Some("compressed-tensors")),
];
/// Files beside `config.json` that older writers use, the keys that lead to the description, and
/// its method.
const BESIDE: [(&str, &[&str], &str); 3] = [
    ("quantize_config.json", &[], "gptq"),
    ("quant_config.json", &[], "awq"),
    ("hf_quant_config.json", &["quantization"], "modelopt"),
];

/// How the layers of a folder are packed, as its files say.
#[derive(Debug)]
pub(super) struct Description {
    path: PathBuf,
    json: Value,
    /// Keys from the root to it.
    keys: &'static [&'static str],
    /// Its method, in small letters.
    pub method: String,
}

impl Description {
    /// The description of a folder; none where the files have none.
    pub(super) fn find(files: &ModelFiles) -> Result<Option<Self>, MllmError> {
        let json = files.required_json("config.json")?;
        for (keys, method) in IN_CONFIG {
            let path = files.path("config.json");
            if let Some(found) = Self::read(path, &json, keys, method)? {
                return Ok(Some(found));
            }
        }
        for (name, keys, method) in BESIDE {
            if let Some(json) = files.json(name)?
                && let Some(found) = Self::read(files.path(name), &json, keys, Some(method))?
            {
                return Ok(Some(found));
            }
        }
        Ok(None)
    }

    fn read(
        path: PathBuf,
        json: &Value,
        keys: &'static [&'static str],
        method: Option<&str>,
    ) -> Result<Option<Self>, MllmError> {
        let Some(object) = object(&path, json, keys)? else {
            return Ok(None);
        };
        let named: Option<String> = object.value("quant_method")?;
        let is_mlx = object.contains("group_size") && object.contains("bits");
        let method = match named.as_deref().or(method) {
            Some(method) => method.to_lowercase(),
            None if is_mlx => MLX.to_owned(),
            None => "unnamed".to_owned(),
        };
        drop(object);
        Ok(Some(Self {
            path,
            json: json.clone(),
            keys,
            method,
        }))
    }

    /// Its keys.
    pub(super) fn settings(&self) -> Result<ConfigObject<'_>, MllmError> {
        match object(&self.path, &self.json, self.keys)? {
            Some(object) => Ok(object),
            None => ConfigObject::root(&self.path, &Value::Object(serde_json::Map::new())),
        }
    }

    /// The note where all weights are plain.
    pub(super) fn ignored(&self) -> String {
        format!(
            "{}: the description of quantization '{}' is ignored: all weights are plain numbers",
            self.path.display(),
            self.method
        )
    }
}

/// The object that keys lead to.
fn object<'a>(
    path: &'a std::path::Path,
    json: &Value,
    keys: &[&str],
) -> Result<Option<ConfigObject<'a>>, MllmError> {
    let mut object = ConfigObject::root(path, json)?;
    for key in keys {
        match object.child(key)? {
            Some(child) => object = child,
            None => return Ok(None),
        }
    }
    Ok(Some(object))
}
