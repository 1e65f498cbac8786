"""The baselines of the suite; :data:`shuttle_marl.suite.method.BASELINES` names them."""
