"""Names by content: the digest of an experiment, and seeds derived from its root seed."""

import hashlib
import json

import numpy as np

from twin.config.models import Experiment

# What a person calls it and where numbers come from do not change what is computed.
_NOT_CONTENT = {"name", "description", "provenance"}


def digest(experiment: Experiment) -> str:
    """Return 16 hex digits that name an experiment by everything that changes its result."""
    content = experiment.model_dump(mode="json", exclude=_NOT_CONTENT)
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(canonical.encode(), digest_size=8).hexdigest()


def seed_sequence(experiment: Experiment, stage: str, *keys: int) -> np.random.SeedSequence:
    """Child seed of the experiment's root seed, keyed by stage, case, trial and frame."""
    stage_key = int.from_bytes(hashlib.blake2b(stage.encode(), digest_size=4).digest())
    return np.random.SeedSequence(experiment.seed, spawn_key=(stage_key, *keys))
