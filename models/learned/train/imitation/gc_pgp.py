"""GC-PGP with the parameter names of tuplan_garage."""

import torch
from torch import nn
from torch.nn import functional as F

from . import blocks

POSES, STEPS, LATENT, MODES = 16, 16, 5, 10
# Walks and latent samples of a plan in training. The original clusters a thousand into ten.
SAMPLES = 200
# Epochs in which walks are the driver's, a share: 20 of 110.
PRETRAINED = 2 / 11


class GatLayer(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.query_emb, self.key_emb, self.val_emb = (nn.Linear(width, width) for _ in range(3))
        self.att = nn.MultiheadAttention(width, 1, batch_first=True)

    def forward(self, x, apart):
        return self.att(self.query_emb(x), self.key_emb(x), self.val_emb(x), attn_mask=apart, need_weights=False)[0]


def read(gru, x, lengths):
    """The state of a recurrent layer after the first rows (B, N, T, C), as many as `lengths` (B, N) says; zeros for none."""
    batch, count, times, width = x.shape
    states, _ = gru(x.view(batch * count, times, width))
    last = (lengths.view(-1) - 1).clamp(min=0)
    taken = states[torch.arange(batch * count, device=x.device), last]
    return (taken * (lengths.view(-1, 1) > 0)).view(batch, count, -1)


class Encoder(nn.Module):
    def __init__(self, width=32, step=16):
        super().__init__()
        self.target_agent_emb, self.target_agent_enc = nn.Linear(5, step), nn.GRU(step, width, batch_first=True)
        self.node_emb, self.node_encoder = nn.Linear(8, step), nn.GRU(step, width, batch_first=True)
        self.nbr_emb, self.nbr_enc = nn.Linear(6, step), nn.GRU(step, width, batch_first=True)
        self.query_emb, self.key_emb, self.val_emb = (nn.Linear(width, width) for _ in range(3))
        self.a_n_att = nn.MultiheadAttention(width, 1, batch_first=True)
        self.mix = nn.Linear(2 * width, width)
        self.gat = nn.ModuleList(GatLayer(width) for _ in range(2))

    def forward(self, batch):
        ego = self.target_agent_enc(F.leaky_relu(self.target_agent_emb(batch["ego"])))[1][0]
        red = batch["map.red"][..., None, None].float().expand(-1, -1, batch["map.pose"].shape[2], 1)
        poses = F.leaky_relu(self.node_emb(torch.cat([batch["map.pose"], red], -1)))
        nodes = read(self.node_encoder, poses, batch["map.length"].long())
        steps = batch["agent.step"]
        steps = F.leaky_relu(self.nbr_emb(torch.cat([steps, torch.zeros_like(steps[..., :1])], -1)))
        agents = read(self.nbr_enc, steps, batch["agent.seen"].long().sum(-1))
        # As in the original, the mask of far agents is added: 1 for a far one. Agents that only fill a batch are hidden.
        present = batch["agent.present"]
        some = present.any(1)[:, None, None]
        bias = (batch["far"] if "far" in batch else far(batch)).masked_fill(~present[:, None] & some, -torch.inf)
        query, key, value = self.query_emb(nodes), self.key_emb(agents), self.val_emb(agents)
        heard, _ = self.a_n_att(query, key, value, attn_mask=bias, need_weights=False)
        # Attention to nothing gives the bias of its last layer.
        heard = torch.where(some, heard, self.a_n_att.out_proj.bias)
        nodes = F.leaky_relu(self.mix(torch.cat([nodes, heard], -1)))
        apart = ~adjacency(batch)
        for layer in self.gat:
            nodes = nodes + layer(nodes, apart)
        return ego, nodes


def far(batch):
    """1 for each agent that is not within ten meters of a node (B, N, A)."""
    poses, count = batch["map.pose"][..., :2], batch["map.pose"].shape[2]
    exists = torch.arange(count, device=poses.device) < batch["map.length"].long()[..., None]
    distance = torch.cdist(poses.flatten(1, 2), batch["agent.step"][:, :, -1, :2]).unflatten(1, (-1, count))
    return (distance.masked_fill(~exists[..., None], torch.inf).min(2)[0] > 10).float()


def adjacency(batch):
    """Which nodes an edge joins in either direction (B, N, N), the diagonal included."""
    edges, targets = batch["map.edge"], batch["map.successor"]
    count = edges.shape[1]
    own = torch.arange(count, device=edges.device)[None, :, None]
    targets = torch.where(edges > 0, targets.long(), own.expand_as(edges))
    joined = torch.zeros(len(edges), count, count, dtype=torch.bool, device=edges.device)
    joined.scatter_(2, targets, True)
    return joined | joined.transpose(1, 2) | torch.eye(count, dtype=torch.bool, device=edges.device)


class Positions(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.register_buffer("inv_freq", 1 / 1e4 ** (torch.arange(0, width, 2).float() / width))

    def forward(self, count):
        angle = torch.arange(count, device=self.inv_freq.device)[:, None] * self.inv_freq
        return torch.stack([angle.sin(), angle.cos()], -1).flatten(1)


class Aggregator(nn.Module):
    def __init__(self, width=32, emb=128):
        super().__init__()
        self.pi_h1, self.pi_h2, self.pi_op = nn.Linear(3 * width + 2, width), nn.Linear(width, width), nn.Linear(width, 1)
        self.pi_h1_goal, self.pi_h2_goal = nn.Linear(2 * width, width), nn.Linear(width, width)
        self.pi_op_goal = nn.Linear(width, 1)
        self.pos_enc = Positions(width)
        self.query_emb, self.key_emb, self.val_emb = (nn.Linear(width, emb) for _ in range(3))
        self.mha = nn.MultiheadAttention(emb, 32, batch_first=True)

    def policy(self, ego, nodes, batch):
        """Probabilities of edges and goal (B, N, K + 1), without regard to the route, as in training."""
        edges = batch["map.edge"]
        count, choices = edges.shape[1:]
        own = torch.arange(count, device=edges.device)[None, :, None]
        places = torch.where(edges > 0, batch["map.successor"].long(), own.expand_as(edges))
        target = nodes.gather(1, places.flatten(1)[..., None].expand(-1, -1, nodes.shape[2])).unflatten(1, (count, choices))
        source = nodes[:, :, None].expand_as(target)
        beside = ego[:, None, None].expand_as(target)
        kinds = torch.stack([edges == 1, edges == 2], -1).float()
        edge = torch.cat([beside, source, target, kinds], -1)
        edge = self.pi_op(F.leaky_relu(self.pi_h2(F.leaky_relu(self.pi_h1(edge)))))[..., 0]
        goal = torch.cat([ego[:, None].expand_as(nodes), nodes], -1)
        goal = self.pi_op_goal(F.leaky_relu(self.pi_h2_goal(F.leaky_relu(self.pi_h1_goal(goal)))))
        raised = torch.cat([edge, goal], -1).exp() * F.pad((edges > 0).float(), (0, 1), value=1.0)
        return raised / raised.sum(-1, keepdim=True)

    def contexts(self, ego, nodes, walks):
        """Contexts (B, S, 160) of walks (B, S, 16): nodes, or at least N for the goal."""
        count, heads = nodes.shape[1], self.mha.num_heads
        parts = zip(self.mha.in_proj_weight.chunk(3), self.mha.in_proj_bias.chunk(3))
        to_query, to_key, to_value = ((lambda x, w=w, b=b: F.linear(x, w, b).unflatten(-1, (heads, -1))) for w, b in parts)
        query = to_query(self.query_emb(ego))

        def on_walks(project, reduce):
            """A step of a walk is node plus position. The projection is affine, so both are projected alone, before walks repeat them."""
            steps = project(self.pos_enc(walks.shape[2])) - project(torch.zeros_like(nodes[0, :1]))
            of_nodes, of_steps = reduce(F.pad(project(nodes), (0, 0, 0, 0, 0, 1))), reduce(steps.expand(len(ego), -1, -1, -1))
            flat = walks.clamp(max=count).flatten(1)[..., None].expand(-1, -1, of_nodes.flatten(2).shape[2])
            taken = of_nodes.flatten(2).gather(1, flat).view(*walks.shape, *of_nodes.shape[2:])
            return taken + of_steps[:, None]

        logits = on_walks(lambda x: to_key(self.key_emb(x)), lambda keys: torch.einsum("bnhc,bhc->bnh", keys, query))
        logits = logits.masked_fill((walks >= count)[..., None], -torch.inf) / query.shape[-1] ** 0.5
        values = on_walks(lambda x: to_value(self.val_emb(x)), lambda values: values)
        mixed = self.mha.out_proj(torch.einsum("bsth,bsthc->bshc", logits.softmax(2), values).flatten(2))
        return torch.cat([ego[:, None].expand_as(mixed[..., : ego.shape[1]]), mixed], -1)


class Decoder(nn.Module):
    def __init__(self):
        super().__init__()
        self.hidden, self.op_traj = nn.Linear(160 + LATENT, 128), nn.Linear(128, 2 * POSES)

    def forward(self, contexts, latent):
        x = F.leaky_relu(self.hidden(torch.cat([contexts, latent], -1)))
        return self.op_traj(x).view(*contexts.shape[:2], POSES, 2)


class Model(nn.Module):
    pretraining = False

    def __init__(self):
        super().__init__()
        self.encoder, self.aggregator, self.decoder = Encoder(), Aggregator(), Decoder()

    def forward(self, batch, samples=SAMPLES):
        """Trajectories (B, S, 16, 2) and the policy."""
        ego, nodes = self.encoder(batch)
        policy = self.aggregator.policy(ego, nodes, batch)
        if self.pretraining:
            walks = batch["traversal"].long()
            goal = walks >= batch["polygons"].long()[:, None]
            walks = walks.masked_fill(goal, nodes.shape[1])[:, None].expand(-1, samples, -1)
        else:
            walks = drawn(policy.detach(), batch, samples)
        contexts = self.aggregator.contexts(ego, nodes, walks)
        return self.decoder(contexts, torch.randn(*contexts.shape[:2], LATENT, device=contexts.device)), policy


def drawn(policy, batch, samples):
    """Random walks (B, S, 16)."""
    count = policy.shape[1]
    state = torch.multinomial(batch["map.initial"].float() + 1e-9 * (batch["map.length"] > 0), samples, replacement=True)
    targets = torch.cat([batch["map.successor"].long(), torch.full_like(policy[..., :1].long(), count)], -1)
    walks = [state]
    for _ in range(STEPS - 1):
        place = state.clamp(max=count - 1)
        shares = policy.gather(1, place[..., None].expand(-1, -1, policy.shape[2]))
        edge = torch.multinomial(shares.flatten(0, 1), 1).view(state.shape)
        after = targets.gather(1, place[..., None].expand(-1, -1, targets.shape[2])).gather(2, edge[..., None])[..., 0]
        state = torch.where(state >= count, state, after)
        walks.append(state)
    return torch.stack(walks, -1)


def clustered(trajectories):
    """The mean trajectories of ten clusters (B, 10, 16, 2), by their third poses; the assignment carries no gradient."""
    rows = trajectories.detach()[:, :, ::3].flatten(2)
    centers = rows[:, torch.randperm(rows.shape[1])[:MODES]]
    for _ in range(20):
        label = torch.cdist(rows, centers).argmin(-1)
        share = F.one_hot(label, MODES).float()
        size = share.sum(1)[..., None]
        centers = torch.where(size > 0, share.transpose(1, 2) @ rows / size.clamp(min=1), centers)
    means = torch.einsum("bsk,bstc->bktc", share, trajectories) / size[..., None].clamp(min=1)
    # An empty cluster stands for the trajectory that it began with.
    return torch.where(size[..., None] > 0, means, trajectories[:, :MODES])


def loss(model, batch):
    """The least average displacement of the modes, and half the negative log-likelihood of the driver's edges."""
    trajectories, policy = model(batch)
    modes = clustered(trajectories)
    least = (modes - batch["target"][:, None, :, :2]).norm(dim=-1).mean(-1).min(1)[0]
    visited = (policy + 1e-5).log() * batch["map.visited"].float()
    return least.mean() - 0.5 * visited.flatten(1).sum(1).mean()


def begin_epoch(model, epoch, epochs):
    model.pretraining = epoch < PRETRAINED * epochs


def augmented(batch, generator):
    """Half of the samples lose half of their agents; half get another present place, to which their history leads; a fifth of the
    histories are zeroed."""
    batch = blocks.without_agents(batch, generator, "agent.present")
    count, device = len(batch["ego"]), batch["ego"].device
    deviation = torch.tensor([1.0, 1.0])
    noise = (torch.tensor([1.0, 0.0]) + deviation * torch.randn(count, 2, generator=generator)).to(device)
    chosen = torch.rand(count, generator=generator).to(device) < 0.5
    bent = blocks.bent_history(batch["ego"][..., :2], noise, chosen)
    forward = (bent[:, 1:, 0] >= bent[:, :-1, 0]).all(1)
    ego = batch["ego"].clone()
    ego[..., :2] = torch.where((forward & chosen)[:, None, None], bent, ego[..., :2])
    zeroed = torch.rand(count, generator=generator).to(device) < 0.2
    return {**batch, "ego": ego * ~zeroed[:, None, None]}


def displacement(model, batch):
    """Of the mean of all trajectories."""
    trajectories, _ = model(batch)
    return blocks.displacements(trajectories.mean(1), batch)


def optimizer(model):
    return torch.optim.Adam(model.parameters(), lr=1e-4)


# Epochs 40, 50 and 55 of 110.
learning_rate = blocks.steps(40 / 110, 50 / 110, 55 / 110, factor=0.5)
EPOCHS, BATCH, GRADIENT_NORM = 110, 32, None
