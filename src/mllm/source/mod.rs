//! Where a model comes from: a folder with safetensors, GGUF files, the program itself, or random
//! weights in a known shape.

mod adapted;
mod embedded;
mod gguf;
mod quantized;
mod random;
mod shape;
mod unread;

pub use embedded::EmbeddedModel;
pub use shape::ModelShape;

use super::MllmError;
use super::checkpoint::{LlamaConfig, ModelFiles, Weights, safetensors_folder};
use super::families::{Architecture, Families};
use super::family::VisionLanguageModel;
use super::gguf::{
    WHOLE_MODEL, decoder_files, files as gguf_files, find as find_gguf, open_model, packed_files,
    tower_for,
};
use planagent_kernels::matrix::WeightFormat;
use std::path::{Path, PathBuf};

/// Where the files of a model are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelPlace {
    /// A folder as Hugging Face writes it, or one with GGUF files that belong together.
    Folder(PathBuf),
    Gguf {
        /// The decoder, or the whole model.
        model: PathBuf,
        /// The vision tower; none if it is in the same file, or for the one that lies beside it.
        mmproj: Option<PathBuf>,
    },
    /// A GGUF decoder that is opened as a language model, also where a vision tower lies beside it
    /// (`vision = false` in a description).
    Decoder(PathBuf),
    /// Files in the program.
    Embedded(&'static EmbeddedModel),
    /// Random weights in the shape of a known model, in [`DEFAULT_RANDOM_FORMAT`] unless another
    /// format is asked for.
    Random {
        shape: &'static ModelShape,
        seed: u64,
    },
}

/// The format that the weights of known models are published in.
const DEFAULT_RANDOM_FORMAT: WeightFormat = WeightFormat::F16;

impl ModelPlace {
    /// The folder, or the file of the decoder; of random weights the name of their shape.
    pub fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Gguf { model: path, .. } | Self::Decoder(path) => path,
            Self::Embedded(model) => Path::new(model.name),
            Self::Random { shape, .. } => Path::new(shape.name),
        }
    }

    /// The decoder of these files, without its vision tower.
    ///
    /// # Errors
    /// When they are no GGUF files.
    pub(crate) fn decoder_alone(self) -> Result<Self, MllmError> {
        let whole = |path: &Path| {
            MllmError::Config {
            path: path.to_path_buf(),
            key: "vision".to_owned(),
            problem: "false is for the decoder of a GGUF file; these files are one model with or without a tower".to_owned(),
        }
        };
        match self {
            Self::Gguf { model, .. } => Ok(Self::Decoder(model)),
            Self::Folder(folder) if !safetensors_folder::has_safetensors(&folder) => {
                let model = find_gguf(&folder)?;
                model.map(Self::Decoder).ok_or_else(|| whole(&folder))
            }
            Self::Decoder(_) => Ok(self),
            Self::Folder(_) | Self::Embedded(_) | Self::Random { .. } => Err(whole(self.path())),
        }
    }

    /// The GGUF files that llama.cpp opens too: the decoder, and its vision tower if it has one.
    /// None for other files, and for a whole model in one file.
    pub fn decoder_and_tower(&self) -> Result<Option<(PathBuf, Option<PathBuf>)>, MllmError> {
        let (model, mmproj) = match self {
            Self::Folder(folder) if !safetensors_folder::has_safetensors(folder) => {
                match find_gguf(folder)? {
                    Some(model) => (model, None),
                    None => return Ok(None),
                }
            }
            Self::Gguf { model, mmproj } => (model.clone(), mmproj.clone()),
            Self::Decoder(model) => (model.clone(), None),
            Self::Folder(_) | Self::Embedded(_) | Self::Random { .. } => return Ok(None),
        };
        let header = open_model(&model)?.0;
        if header.architecture()? == WHOLE_MODEL {
            return Ok(None);
        }
        let tower = if matches!(self, Self::Decoder(_)) {
            None
        } else {
            tower_for(&header, mmproj.as_deref())?
        };
        Ok(Some((model, tower)))
    }

    /// Why there is nothing to open: the folder or the file of the decoder does not exist.
    pub fn absent(&self) -> Option<MllmError> {
        match self {
            Self::Folder(path) | Self::Gguf { model: path, .. } | Self::Decoder(path)
                if !path.exists() =>
            {
                Some(MllmError::Absent { path: path.clone() })
            }
            _ => None,
        }
    }

    /// A small file of the model: in its folder, or in the metadata of its GGUF file.
    pub(crate) fn small_file(&self, name: &str) -> Result<Option<String>, MllmError> {
        let model = match self {
            Self::Folder(folder) if !safetensors_folder::has_safetensors(folder) => {
                match find_gguf(folder)? {
                    Some(model) => model,
                    None => return ModelFiles::folder(folder)?.text(name),
                }
            }
            Self::Folder(folder) => return ModelFiles::folder(folder)?.text(name),
            Self::Gguf { model, .. } | Self::Decoder(model) => model.clone(),
            Self::Embedded(_) | Self::Random { .. } => return Ok(None),
        };
        Ok(packed_files(&open_model(&model)?.0)?.remove(name))
    }

    /// What the files call the model, and the number of their weights; none where they cannot be
    /// read. They tell refused models apart.
    pub fn facts(&self) -> Option<(String, u64)> {
        let gguf = |path: &Path| {
            let header = open_model(path).ok()?.0;
            let kind = format!("GGUF of architecture {}", header.architecture().ok()?);
            Some((kind, header.parameters()))
        };
        match self {
            Self::Folder(folder) if safetensors_folder::has_safetensors(folder) => {
                let config = ModelFiles::folder(folder)
                    .ok()?
                    .json("config.json")
                    .ok()??;
                let named = config
                    .get("model_type")
                    .or(config.pointer("/architectures/0"));
                let kind = named?.as_str()?.to_owned();
                let files = ModelFiles::folder(folder).ok()?;
                let weights = quantized::open(&files, folder, None, |name| Some(name.to_owned()));
                Some((kind, weights.map_or(0, |weights| weights.elements() as u64)))
            }
            Self::Folder(folder) => gguf(&find_gguf(folder).ok()??),
            Self::Gguf { model, .. } | Self::Decoder(model) => gguf(model),
            Self::Embedded(_) | Self::Random { .. } => None,
        }
    }

    pub fn weight_bytes(&self) -> Result<u64, MllmError> {
        let files = match self {
            Self::Folder(folder) if safetensors_folder::has_safetensors(folder) => {
                safetensors_folder::weight_files(folder)?
            }
            Self::Folder(folder) => match find_gguf(folder)? {
                Some(model) => gguf_files(&model, None)?,
                None => {
                    return Err(
                        ModelFiles::folder(folder)?.missing("model.safetensors, and no GGUF file")
                    );
                }
            },
            Self::Gguf { model, mmproj } => gguf_files(model, mmproj.as_deref())?,
            Self::Decoder(model) => decoder_files(model)?,
            Self::Embedded(model) => return Ok(model.weights.len() as u64),
            Self::Random { .. } => Vec::new(),
        };
        let bytes = |path: &PathBuf| {
            let metadata = std::fs::metadata(path).map_err(|source| MllmError::Read {
                path: path.clone(),
                source,
            })?;
            Ok(metadata.len())
        };
        files.iter().map(bytes).sum()
    }
}

/// A model's family, its small files and its weights.
#[derive(Debug)]
pub(crate) struct Checkpoint {
    pub family: Architecture,
    pub files: ModelFiles,
    pub weights: Weights,
}

impl Checkpoint {
    /// Opens the small files of a model and the headers of its weights, whose format in memory is
    /// `quantize`.
    pub(crate) fn open(
        place: &ModelPlace,
        quantize: Option<WeightFormat>,
        families: &Families,
    ) -> Result<Self, MllmError> {
        let folder = match place {
            ModelPlace::Gguf { model, mmproj } => {
                return gguf::open(model, mmproj.as_deref(), quantize, families);
            }
            ModelPlace::Decoder(model) => return gguf::open_decoder(model, quantize, families),
            ModelPlace::Embedded(model) => return model.checkpoint(quantize, families),
            ModelPlace::Random { shape, seed } => {
                let files = shape.files(families)?;
                return random::checkpoint(
                    files,
                    quantize.unwrap_or(DEFAULT_RANDOM_FORMAT),
                    *seed,
                    families,
                );
            }
            ModelPlace::Folder(folder) => folder,
        };
        let files = ModelFiles::folder(folder)?;
        // Safetensors win where both are there: they have all digits of the model.
        if !safetensors_folder::has_safetensors(folder)
            && let Some(model) = find_gguf(folder)?
        {
            return gguf::open(&model, None, quantize, families);
        }
        unread::check_folder(folder)?;
        unread::check_config(&files)?;
        let family = families.detect_in(&files)?;
        let weights = quantized::open(&files, folder, quantize, family.family().canonical_name)?;
        Ok(Self {
            family,
            files,
            weights,
        })
    }

    /// The configuration of the decoder.
    pub(crate) fn decoder_config(&self) -> Result<LlamaConfig, MllmError> {
        (self.family.family().decoder_config)(&self.files)
            .map_err(|error| self.files.by_own_key(error))
    }

    /// Opens the model and takes its weights.
    pub(crate) fn open_model(&mut self) -> Result<Box<dyn VisionLanguageModel>, MllmError> {
        (self.family.family().open)(&self.files, &mut self.weights)
            .map_err(|error| self.by_own_name(error))
    }

    /// An error by the file and the name that a key or a tensor has on the disk.
    pub(crate) fn by_own_name(&self, error: MllmError) -> MllmError {
        let own = |name: &str| {
            let own = self.family.family().gguf.ok()?.gguf_name(name)?;
            let file = self.files.file_of_tensor(&own)?.to_path_buf();
            Some((file, own))
        };
        match self.files.by_own_key(error) {
            MllmError::MissingTensor { folder, name } => {
                let (folder, name) = own(&name).unwrap_or((folder, name));
                MllmError::MissingTensor { folder, name }
            }
            error => error,
        }
    }
}
