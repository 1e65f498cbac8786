"""Models fitted to matches, and the games compiled from them. Names are imported, and PyTorch with them, when first used."""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.dynamics.fitted import FittedModels, load_models
    from shuttle_marl.dynamics.make import fit_model
    from shuttle_marl.dynamics.modules import MContact, MHurried, MRet, MSucc

__all__ = ["FittedModels", "MContact", "MHurried", "MRet", "MSucc", "fit_model", "load_models"]

__getattr__, __dir__ = lazily(__name__)
