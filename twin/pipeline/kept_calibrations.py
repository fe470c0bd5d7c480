"""Stored calibrations of photometric sensors, one folder for all measurements of a sensor.

DIR/NAME/ holds one: the values of all fields that it was made from, as the stages read them
(`reads.json`, see `memory`), and an .npz file per colour map. It is valid for every experiment with
the same values in these fields, by any process. `reads.json` is written last, each file under
another name and renamed: a calibration is never half there, and two processes may write the same.
"""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic_core import to_json

from reconstruction.colour_maps import maps_in_order
from reconstruction.errors import InputError
from reconstruction.machine import unwritable
from reconstruction.photometric import (
    SensorCalibration,
    read_sensor_calibration,
    write_sensor_calibration,
)
from reconstruction.reading import read_json
from twin.config import Experiment
from twin.files import naming_unwritable
from twin.output import replace_json, versions
from twin.pipeline.memory import Reads

_READS_FILE = "reads.json"

Calibrations = dict[str, SensorCalibration]


@dataclass(frozen=True)
class KeptCalibrations:
    """Cache of sensor calibrations in a folder; the first `put` creates the folder."""

    folder: Path

    def find(self, experiment: Experiment) -> Calibrations | None:
        """Return the calibrations of an experiment's sensor by colour map, if they are kept.

        A damaged entry counts as absent: it is computed again.
        """
        for file in sorted(self.folder.glob(f"*/{_READS_FILE}")):
            with suppress(InputError):
                content = read_json(file)
                same = content.get("versions") == versions()
                if same and Reads.from_json(content["reads"]).hold_for(experiment):
                    kinds = [kind.name for kind in maps_in_order()]
                    return {kind: read_sensor_calibration(_file(file, kind)) for kind in kinds}
        return None

    def put(self, reads: Sequence[Reads], calibrations: Mapping[str, SensorCalibration]) -> None:
        """Store calibrations with the fields that their stages read.

        Raises
        ------
        InputError : the folder cannot be written
        """
        content = {"versions": versions(), "reads": Reads.union(reads).as_json()}
        name = hashlib.blake2b(to_json(content), digest_size=8).hexdigest()
        place = self.folder / name
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(place, error) from None
        for kind, calibration in calibrations.items():
            file = _file(place / _READS_FILE, kind)
            with naming_unwritable(file):
                write_sensor_calibration(file, calibration)
        replace_json(place / _READS_FILE, content)


def _file(folder: Path, kind: str) -> Path:
    return folder.with_name(f"{kind}.npz")
