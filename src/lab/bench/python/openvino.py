"""OpenVINO behind worker.py: the models that openvino_export.py wrote, through the runtime of the package openvino.

A decoder keeps its keys and values as its state. Going back in it cuts the state, as openvino-genai does. The output layer
computes the last token alone, as there too. All settings of OpenVINO are its defaults except threads, and except what makes
`f32` exact.
"""

import itertools
import pathlib


class Features:
    """The numbers of a picture's tokens, and those for early layers of the decoder, if it has such."""

    def __init__(self, rows, deep=None):
        self.rows, self.deep = rows, deep

    def of_tokens(self):
        """All numbers of each token, those for early layers behind the others."""
        parts = [self.rows] if self.deep is None else [self.rows, *self.deep]
        return np.concatenate(parts, axis=1).tolist()


def normalized(pixels, side, recipe):
    """A square picture as the towers take it: channels, rows, columns."""
    picture = np.frombuffer(pixels, np.uint8).reshape(side, side, 3).astype(np.float32)
    return ((picture / 255 - np.float32(recipe["mean"])) / np.float32(recipe["std"])).transpose(2, 0, 1)


class Tower:
    """A vision tower with its projector, for a square of one size."""

    def __init__(self, folder, compiled, recipe, like):
        self.request = compiled(folder / "openvino_vision_embeddings_model.xml")
        self.recipe = recipe
        self.side, self.views = recipe["side"], 1
        if like["image_side"] != self.side:
            raise Problem(f"the image has {like['image_side']} px, and the tower of {folder} takes {self.side}")
        tokens = len(self.encode(bytes(3 * self.side * self.side)).rows)
        self.views, rest = divmod(like["image_tokens"], tokens)
        if rest or not self.views:
            raise Problem(f"{folder} makes {tokens} tokens of a view, and the image has {like['image_tokens']}")
        self.image_tokens = self.positions = like["image_tokens"]

    def encode(self, pixels):
        """The numbers of the tokens of a square picture. Every view shows the whole of it."""
        picture = normalized(pixels, self.side, self.recipe)
        inputs = {"pixel_values": np.repeat(picture[None], self.views, axis=0)}
        if self.recipe["patches"]:
            # The whole picture is seen: no patch is masked, and each is where it is.
            along = self.side // self.recipe["patches"]
            inputs["patch_attention_mask"] = np.ones((self.views, along, along), bool)
            inputs["patch_position_ids"] = np.repeat(np.arange(along * along)[None], self.views, axis=0)
        self.request.infer(inputs)
        rows = self.request.get_output_tensor(0).data
        return Features(rows.reshape(-1, rows.shape[-1]).copy())

    def places_of(self, start):
        """The positions of the picture's tokens, from `start` on."""
        return start + np.arange(self.image_tokens)[None]


class Engine(Sequence):
    """A decoder with its vision tower, and one sequence of tokens."""

    def __init__(self, request):
        super().__init__(request["seed"])
        self.api = runtime()
        if "exported" not in request["model"] or not request["like"]:
            raise Problem("OpenVINO loads what it prepared itself, and must be told how large the image is")
        folder = pathlib.Path(request["model"]["exported"]["export"])
        self.recipe = recipe_of(folder)
        start = now_ms()
        core = self.api.Core()
        like = request["like"]
        # The decoder is the last to be compiled: its own precision is reported.
        self.embeddings = self.tower = None
        if self.recipe["side"]:
            embeddings = folder / "openvino_text_embeddings_model.xml"
            self.embeddings = self.compiled(core, request["threads"], self.recipe["weights"])(embeddings)
            tower = QwenTower if self.recipe["merged"] else Tower
            self.tower = tower(folder, self.compiled(core, request["threads"], self.recipe["tower"]), self.recipe, like)
        decoder = core.read_model(folder / self.recipe["decoder"])
        self.inputs = {name for port in decoder.inputs for name in port.names}
        keep_last_token(self.api, decoder)
        self.request = self.compiled(core, request["threads"], self.recipe["weights"])(decoder)
        self.context = min(like["context"], self.recipe["context"])
        # Tokens in the state, and behind each picture by how much the next position is below their number.
        self.length = 0
        self.shared = []
        # Those of the picture that was encoded last. Pending are tokens, and such.
        self.features = None
        self.side = self.tower.side if self.tower else 0
        self.pixels = self.words.randbytes(3 * self.side * self.side)
        self.load_s = (now_ms() - start) / 1e3
        self.pending = [0]
        self.compute(StepTime())
        self.vocabulary = len(self.logits())
        self.keep(0)

    def compiled(self, core, threads, precision):
        """A function that compiles a model for this precision and makes a request for it."""
        settings = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_NUM_THREADS": threads, "NUM_STREAMS": 1}
        if precision == "f32":
            settings |= {"INFERENCE_PRECISION_HINT": "f32", "KV_CACHE_PRECISION": "f32", "DYNAMIC_QUANTIZATION_GROUP_SIZE": 0}

        def compiled(model):
            network = core.compile_model(model, "CPU", settings)
            self.arithmetic = network.get_property("INFERENCE_PRECISION_HINT").to_string()
            return network.create_infer_request()

        return compiled

    def describe(self):
        recipe = self.recipe
        return {
            "parameters": 0,
            "weight_format": recipe["weights"] + (f", {recipe['tower']} tower" if self.tower else ""),
            "image_side": self.side,
            "image_tokens": self.tower.image_tokens if self.tower else 0,
            "vocabulary": self.vocabulary,
            "context": self.context,
            "layout": "prefix_first",
            "load_s": self.load_s,
            "version": f"{version_of('openvino')} ({self.arithmetic} arithmetic, exported by {recipe['by']})",
        }

    def encode(self):
        if self.tower:
            self.features = self.tower.encode(self.pixels)

    def features_of(self, pixels, side):
        if not self.tower:
            return []
        if side != self.side:
            raise Problem(f"the picture has {side} px, and the tower takes {self.side}")
        return self.tower.encode(pixels).of_tokens()

    def append_image(self, step):
        if self.tower:
            self.pending.append(self.features)

    def missing(self):
        """By how much the position of the next token is below the number of tokens."""
        return self.shared[-1][1] if self.shared else 0

    def embedded(self, tokens):
        self.embeddings.infer([np.array([tokens])])
        return self.embeddings.get_output_tensor(0).data[0].copy()

    def inputs_of_pending(self):
        """The pending tokens and pictures as the input of one pass, and their number."""
        if not self.embeddings:
            places = self.length + np.arange(len(self.pending))
            return {"input_ids": np.array([self.pending]), "position_ids": places[None]}, len(places)
        rows, places, seen, deep, end = [], [], [], [], self.length
        for is_picture, items in itertools.groupby(self.pending, lambda item: isinstance(item, Features)):
            start = end - self.missing()
            if is_picture:
                (picture,) = items
                rows.append(picture.rows)
                places.append(self.tower.places_of(start))
                deep.append(picture.deep)
            else:
                rows.append(self.embedded(list(items)))
                places.append(np.repeat(start + np.arange(len(rows[-1]))[None], self.recipe["axes"], axis=0))
            seen.append(np.full(len(rows[-1]), is_picture))
            end += len(rows[-1])
            if is_picture:
                self.shared.append((end, self.missing() + len(picture.rows) - self.tower.positions))
        embedded, places = np.concatenate(rows)[None], np.concatenate(places, axis=1)
        # One axis is that of the sequences, several come before it.
        inputs = {"inputs_embeds": embedded, "position_ids": places if len(places) == 1 else places[:, None]}
        if "visual_pos_masks" in self.inputs:
            # A row that no token takes.
            nothing = np.zeros((self.recipe["deep"], 1, embedded.shape[2]), np.float32)
            inputs["visual_pos_masks"] = np.concatenate(seen)[None]
            inputs["deepstack_visual_embeds"] = np.concatenate(deep, axis=1) if deep else nothing
        return inputs, embedded.shape[1]

    def compute(self, step):
        """Computes the pending tokens in one pass; the logits of the last one are available afterwards."""
        if not self.pending:
            return
        start = now_ms()
        inputs, count = self.inputs_of_pending()
        inputs["attention_mask"] = np.ones((1, self.length + count), np.int64)
        inputs["beam_idx"] = np.zeros(1, np.int32)
        self.request.infer({name: given for name, given in inputs.items() if name in self.inputs})
        step.add_pass(count, now_ms() - start)
        self.length += count
        self.pending = []

    def last_logits(self):
        return self.request.get_tensor("logits").data[0, -1]

    def likeliest(self):
        return int(self.last_logits().argmax())

    def logits(self):
        return self.last_logits().tolist()

    def keep(self, tokens):
        self.pending = []
        if tokens >= self.length:
            return
        self.shared = [picture for picture in self.shared if picture[0] <= tokens]
        if tokens == 0:
            self.request.reset_state()
        else:
            for state in self.request.query_state():
                whole = state.state.data
                if whole.ndim != 4 or whole.shape[2] != self.length:
                    raise Problem(f"the state {state.name} of shape {whole.shape} cannot go back to {tokens} tokens")
                state.state = self.api.Tensor(np.ascontiguousarray(whole[:, :, :tokens]))
        self.length = tokens


def keep_last_token(api, decoder):
    """Lets the output layer read the last token alone.

    Raises:
        Problem: if no product of matrices ends the decoder.
    """
    node = decoder.output("logits").get_node().input_value(0).get_node()
    behind = {"Add", "Convert", "Divide", "Multiply", "Tanh", "Transpose"}
    while node.get_type_name() in behind:
        node = node.input_value(0).get_node()
    if node.get_type_name() != "MatMul":
        raise Problem(f"a decoder that ends in {node.get_type_name()} cannot be compared: its output layer is not found")
    whole = np.array([np.iinfo(np.int64).max])
    last = api.opset13.slice(node.input_value(0), np.array([-1]), whole, np.array([1]), np.array([1]))
    node.input(0).replace_source_output(last.output(0))
    decoder.validate_nodes_and_infer_types()
