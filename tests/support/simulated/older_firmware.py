"""A turntable whose firmware words three replies in another way than ours."""

from typing import Any

from sim_instruments.acutrol_3000 import Acutrol3000


class OlderFirmware(Acutrol3000):
    """Six limits instead of seven, modes as whole words, messages in quotes: forms that public programs show."""

    identity = "ACUTRONIC,ACUTROL3000,SIM3000,0.9"

    def reply(self, text: str, **more: Any) -> None:
        modes = {"O": "Off", "P": "Position", "R": "Rate"}
        fields = text.split(",")
        text = ",".join(fields[:6]) if len(fields) == len(self.axes[0].absolute) else modes.get(text, text)
        super().reply(f'"{text}"' if len(fields) == 2 and fields[0].isdigit() else text, **more)
