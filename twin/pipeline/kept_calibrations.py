"""Store calibrations of simulated photometric sensors in a folder, for other processes.

Each calibration has a folder DIR/NAME/ with `reads.json` and an .npz file per colour map.
`reads.json` has the values of all fields of the experiment that the stages of the calibration read,
see `memory`. The calibration is valid for every experiment with the same values in these fields.
Each file is written under a temporary name and renamed, and `reads.json` is written last. An
incomplete calibration is therefore never read, and two processes may write the same calibration.
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
        """Return the stored calibrations of an experiment's sensor by kind of colour map.

        None if they are not stored. A damaged entry is ignored.
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
        """Store the calibrations of a sensor with the fields that their stages read.

        Parameters
        ----------
        reads : fields that were read by each stage of the calibration
        calibrations : calibration by kind of colour map

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
