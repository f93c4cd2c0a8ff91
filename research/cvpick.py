import json,sys
import numpy as np
D=[json.loads(l) for l in open(sys.argv[1])]
def cvrule(r,c,how):
    P=r["part"]; cv=np.array([x["cv"] for x in P]); R=np.array([x["R"] for x in P]); 
    if how=="m": ok=cv<=cv.min()+c*r["mw"]
    elif how=="rms": ok=np.sqrt(R)<=np.sqrt(R.min())*(1+c)
    elif how=="wrms": ok=np.sqrt(cv)<=np.sqrt(cv.min())*(1+c)
    k=int(np.argmax(ok)); return k
for how,cs in (("m",(0,.02,.05,.1,.15,.2,.25,.3,.35,.4,.5)),("rms",(0,.01,.02,.03,.05,.08,.12)),("wrms",(0,.01,.02,.03,.05,.08,.12,.2))):
    for c in cs:
        L=[]
        for r in D:
            err=np.array([x["err"] for x in r["rows"]]); L.append(err[cvrule(r,c,how)]/err.min())
        print(how,c,"median %.3f p90 %.3f max %.2f"%(np.median(L),np.percentile(L,90),max(L)))
for r in D:
    P=r["part"]; err=np.array([x["err"] for x in r["rows"]]); b=int(err.argmin()); cv=np.array([x["cv"] for x in P]); R=np.sqrt([x["R"] for x in P])
    print(r["seed"],r["family"],"v",r["views"],"nv/m2 %.2f"%(r["nv"]/r["m2"]),"best e",P[b]["e"],"excess/mw at best %.3f (next %.3f, %.3f)"%tuple((cv[max(0,min(len(cv)-1,k))]-cv.min())/r["mw"] for k in (b,b-1,b+1)),"rms ratio %.3f (%.3f %.3f)"%tuple(R[max(0,min(len(cv)-1,k))]/R.min() for k in (b,b-1,b+1)), "chosen .25:",P[cvrule(r,.25,'m')]["e"])
