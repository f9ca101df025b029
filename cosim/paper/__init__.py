"""The experiment of Barnard, Briot and Caro (ESDA 2012): tables and figures beside the printed ones."""
