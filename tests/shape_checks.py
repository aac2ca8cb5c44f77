"""The checker behind `--jaxtyping-packages`: types and array shapes of every call, with int allowed for float."""

from beartype import BeartypeConf, beartype

typechecker = beartype(conf=BeartypeConf(is_pep484_tower=True))
