"""llama.cpp behind worker.py, through the low-level interface of the package llama-cpp-python.

Prompts stay in the key-value cache as the steps say. All settings of llama.cpp are its defaults except threads and context.
"""

import ctypes


class Engine(Sequence):
    """A decoder with its vision tower, and one sequence of tokens."""

    def __init__(self, request):
        super().__init__(request["seed"])
        try:
            import llama_cpp
            from llama_cpp import mtmd_cpp
        except (ImportError, OSError) as error:
            raise Problem(f"the Python package llama-cpp-python cannot be used: {error}") from error
        self.api, self.vision_api = llama_cpp, mtmd_cpp
        if "gguf" not in request["model"]:
            raise Problem("llama.cpp loads GGUF files only")
        if not request["like"]:
            raise Problem("llama.cpp must be told how long its context and how large its image is")
        files = request["model"]["gguf"]
        start = now_ms()
        self.quieten()
        llama_cpp.llama_backend_init()
        parameters = llama_cpp.llama_model_default_params()
        parameters.n_gpu_layers = 0
        self.model = llama_cpp.llama_model_load_from_file(files["decoder"].encode(), parameters)
        if not self.model:
            raise Problem(f"{files['decoder']} cannot be loaded")
        settings = llama_cpp.llama_context_default_params()
        settings.n_ctx = request["like"]["context"]
        settings.n_threads = settings.n_threads_batch = request["threads"]
        self.context = llama_cpp.llama_init_from_model(self.model, settings)
        if not self.context:
            raise Problem("no context can be made")
        self.memory = llama_cpp.llama_get_memory(self.context)
        self.most_in_batch = settings.n_batch
        self.sampler = llama_cpp.llama_sampler_init_greedy()
        self.vocabulary = llama_cpp.llama_vocab_n_tokens(llama_cpp.llama_model_get_vocab(self.model))
        # Tokens in the cache, and the position of the next one. Tokens of an image may share one.
        self.tokens = self.length = 0
        self.shared = []
        self.side = self.image_tokens = 0
        self.vision, self.features = None, []
        if files["projector"]:
            self.load_vision(files["projector"], request["threads"], request["like"])
        self.load_s = (now_ms() - start) / 1e3

    def quieten(self):
        """Leaves warnings and errors on stderr, and nothing below."""
        warning = 3

        @self.api.llama_log_callback
        def log(level, text, _):
            if level >= warning and level <= warning + 1:
                sys.stderr.write(text.decode(errors="replace"))

        self.log = log
        nothing = ctypes.c_void_p(0)
        self.api.llama_log_set(log, nothing)
        self.vision_api.mtmd_log_set(log, nothing)
        self.vision_api.mtmd_helper_log_set(log, nothing)

    def load_vision(self, projector, threads, like):
        api = self.vision_api
        settings = api.mtmd_context_params_default()
        settings.use_gpu = False
        settings.print_timings = False
        settings.n_threads = threads
        self.vision = api.mtmd_init_from_file(projector.encode(), self.model, settings)
        if not self.vision:
            raise Problem(f"{projector} cannot be loaded")
        self.side, self.wanted_tokens = like["image_side"], like["image_tokens"]
        self.bitmap = self.bitmap_of(self.words.randbytes(3 * self.side * self.side), self.side)
        self.chunks = None
        self.preprocess()
        self.image_tokens = sum(api.mtmd_input_chunk_get_n_tokens(chunk) for chunk in self.image_chunks())
        if self.image_tokens == 0:
            raise Problem(f"{projector} makes no tokens of an image")

    def bitmap_of(self, pixels, side):
        buffer = (ctypes.c_uint8 * len(pixels)).from_buffer_copy(pixels)
        return self.vision_api.mtmd_bitmap_init(side, side, buffer)

    def describe(self):
        name = ctypes.create_string_buffer(128)
        self.api.llama_model_desc(self.model, name, len(name))
        return {
            "parameters": self.api.llama_model_n_params(self.model),
            "weight_format": name.value.decode(errors="replace"),
            "image_side": self.side,
            "image_tokens": self.image_tokens,
            "vocabulary": self.vocabulary,
            "context": self.api.llama_n_ctx(self.context),
            "layout": "prefix_first",
            "load_s": self.load_s,
            "version": self.api.__version__,
        }

    def preprocess(self):
        """Cuts and scales the image, as llama.cpp does while it tokenizes the marker of one."""
        api = self.vision_api
        if self.chunks:
            api.mtmd_input_chunks_free(self.chunks)
        self.chunks = api.mtmd_input_chunks_init()
        marker = api.mtmd_default_marker()
        text = api.mtmd_input_text(text=marker, text_len=len(marker), add_special=False, parse_special=True)
        bitmaps = (api.mtmd_bitmap_p_ctypes * 1)(self.bitmap)
        if api.mtmd_tokenize(self.vision, self.chunks, ctypes.byref(text), bitmaps, 1) != 0:
            raise Problem("the image cannot be used")

    def image_chunks(self):
        api = self.vision_api
        chunks = (api.mtmd_input_chunks_get(self.chunks, i) for i in range(api.mtmd_input_chunks_size(self.chunks)))
        views = [chunk for chunk in chunks if api.mtmd_input_chunk_get_type(chunk) == api.MTMD_INPUT_CHUNK_TYPE_IMAGE]
        return self.last_views(views)

    def last_views(self, views):
        """The last views with as many tokens as the other engine makes of the image, else all.

        llama.cpp cuts a picture of SmolVLM even where it is one view: into a tile, and the whole picture behind it.
        """
        tokens = 0
        for first in range(len(views) - 1, -1, -1):
            tokens += self.vision_api.mtmd_input_chunk_get_n_tokens(views[first])
            if tokens == self.wanted_tokens:
                return views[first:]
        return views

    def encode(self):
        if not self.vision:
            return
        api = self.vision_api
        self.preprocess()
        self.features = []
        width = self.api.llama_model_n_embd_inp(self.model)
        for chunk in self.image_chunks():
            if api.mtmd_encode_chunk(self.vision, chunk) != 0:
                raise Problem("the image cannot be encoded")
            count = api.mtmd_input_chunk_get_n_tokens(chunk) * width
            rows = (ctypes.c_float * count)()
            ctypes.memmove(rows, api.mtmd_get_output_embd(self.vision), ctypes.sizeof(rows))
            self.features.append((chunk, rows))

    def append_image(self, step):
        api = self.vision_api
        self.compute(step)
        for chunk, rows in self.features:
            start = now_ms()
            length = self.api.llama_pos(0)
            no_callback = api.mtmd_helper_post_decode_callback(0)
            outcome = api.mtmd_helper_decode_image_chunk(
                self.vision,
                self.context,
                chunk,
                rows,
                self.length,
                0,
                self.most_in_batch,
                ctypes.byref(length),
                no_callback,
                None,
            )
            if outcome != 0:
                raise Problem("the image's tokens cannot be decoded")
            self.api.llama_synchronize(self.context)
            tokens = api.mtmd_input_chunk_get_n_tokens(chunk)
            step.add_pass(tokens, now_ms() - start)
            self.tokens += tokens
            missing = self.missing() + tokens - (length.value - self.length)
            self.shared.append((self.tokens, missing))
            self.length = length.value

    def missing(self):
        """By how much the position of the next token is below the number of tokens."""
        return self.shared[-1][1] if self.shared else 0

    def compute(self, step):
        """Decodes the pending tokens; the logits of the last one are available afterwards."""
        for first in range(0, len(self.pending), self.most_in_batch):
            part = self.pending[first : first + self.most_in_batch]
            start = now_ms()
            tokens = (self.api.llama_token * len(part))(*part)
            if self.api.llama_decode(self.context, self.api.llama_batch_get_one(tokens, len(part))) != 0:
                raise Problem(f"{len(part)} tokens at {self.length} cannot be decoded")
            self.api.llama_synchronize(self.context)
            step.add_pass(len(part), now_ms() - start)
            self.length += len(part)
            self.tokens += len(part)
        self.pending = []

    def keep(self, tokens):
        self.pending = []
        self.shared = [image for image in self.shared if image[0] <= tokens]
        length = tokens - self.missing()
        if not self.api.llama_memory_seq_rm(self.memory, 0, length, -1):
            raise Problem(f"the cache cannot go back to {tokens} tokens")
        self.tokens = min(self.tokens, tokens)
        self.length = min(self.length, length)

    def likeliest(self):
        return self.api.llama_sampler_sample(self.sampler, self.context, -1)

    def logits(self):
        return self.api.llama_get_logits_ith(self.context, -1)[: self.vocabulary]

    def features_of(self, pixels, side):
        if not self.vision:
            return []
        drawn, self.bitmap = self.bitmap, self.bitmap_of(pixels, side)
        self.encode()
        self.vision_api.mtmd_bitmap_free(self.bitmap)
        self.bitmap = drawn
        width = self.api.llama_model_n_embd_inp(self.model)
        values = [value for _, rows in self.features for value in rows]
        self.features = []
        return [values[start : start + width] for start in range(0, len(values), width)]
